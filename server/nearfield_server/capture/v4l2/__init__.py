"""Cameras of the Linux video system."""
