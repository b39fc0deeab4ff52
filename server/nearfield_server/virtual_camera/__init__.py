"""A simulated GigE Vision camera that looks at a room: a real GVCP/GVSP device of libaravis, for tests and trials.

What libaravis's device class cannot show: chunk data, a sequencer, packet resend, multi-part payloads, a delay between packets (0.8 sends
every picture as one burst of plain image packets). Everything else is here: exposure, gain, black level, pixel formats, region, software
trigger, device clock, PTP, temperature.
"""
