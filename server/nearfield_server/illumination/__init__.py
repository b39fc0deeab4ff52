"""The illumination process: frame rings in, light packets and atlas tiles out."""
