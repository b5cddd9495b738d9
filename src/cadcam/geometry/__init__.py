"""Rotations and rigid motions: no camera, no picture, no file."""
