"""Deliberate errors of the calibration package."""

from __future__ import annotations


class CalibrationError(ValueError):
    """A camera model cannot be used; the message says which value is wrong and what was expected."""
