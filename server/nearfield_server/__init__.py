"""Nearfield server: cameras in, a few virtual area lights and spherical harmonics out."""
