"""Starts, watches and restarts the processes of the service; owns the frame rings and the control state."""
