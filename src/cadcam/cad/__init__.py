"""Meshes, their feature edges, and parametric sample parts."""
