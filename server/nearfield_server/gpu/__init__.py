"""Everything that needs OpenGL; the only importer of moderngl."""
