"""Slow, plain float64 versions of the light stages: what the fast ones are tested and timed against."""
