"""Lenses, cameras, the extended pinhole and its equivalent in OpenGL."""
