"""Camera models and calibration steps: everything the server needs to know about a lens and a sensor."""
