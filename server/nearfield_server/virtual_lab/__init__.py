"""The virtual lab: path-traced rooms with known truth.

A scene is described as plain data (`model`, `lab_room`, `tiny_room`), traced with Mitsuba's ray caster (`tracer`, `radiosity`,
`render`) and written as an evaluation bundle (`bundle`). Mitsuba is the optional extra `lab`; a shipped bundle needs none of this.
"""
