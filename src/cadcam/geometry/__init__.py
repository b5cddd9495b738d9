"""Rotations, rigid motions, rays and planes: no camera, no picture, no file."""
