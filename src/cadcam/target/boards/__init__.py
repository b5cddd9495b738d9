"""Calibration boards: what they look like, and their points in a picture."""
