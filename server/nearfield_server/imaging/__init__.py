"""PURE: from sensor codes to linear radiance."""
