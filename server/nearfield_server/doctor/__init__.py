"""Looks at a machine before it serves a room: what is missing, what is slow, and the command that mends it."""
