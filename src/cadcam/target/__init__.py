"""Calibration boards and marks: their geometry, and how they are found and measured in a picture."""
