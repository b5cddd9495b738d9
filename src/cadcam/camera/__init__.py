"""Lens, camera, the extended pinhole and OpenGL's values for it."""
