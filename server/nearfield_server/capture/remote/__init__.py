"""Cameras of other machines: frames over zenoh with mutual TLS, written into the service's rings like those of a local camera."""
