"""Cameras rigidly mounted together."""
