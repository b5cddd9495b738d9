"""Calibration boards and marks: what they look like, and where they are in a picture."""
