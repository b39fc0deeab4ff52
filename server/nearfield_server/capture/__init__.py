"""Cameras: sources of frames, sensor simulation, checks at the door, and the shared-memory rings that carry frames."""
