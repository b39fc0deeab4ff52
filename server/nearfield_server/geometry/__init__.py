"""What only changes with the room and its cameras: texels, visibility, the gather table, probe rays."""
