"""Pure mathematics of light: spherical harmonics, cube maps, form factors, half floats."""
