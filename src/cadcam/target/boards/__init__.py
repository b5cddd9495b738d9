"""Calibration boards: their geometry, and the detection of their points in a picture."""
