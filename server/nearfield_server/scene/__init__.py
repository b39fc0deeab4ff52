"""Everything read from disk: rooms, bundles, meshes, prepared models."""
