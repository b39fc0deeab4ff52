"""What a recording looks like on disk: frames in two formats, the light log, the manifest. Knows no camera, ring or process."""
