"""Recordings: written by a process of its own, replayed bit by bit."""
