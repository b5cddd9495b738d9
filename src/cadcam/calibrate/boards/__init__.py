"""Calibration from pictures of a board: detection, checks, adjustment, coverage, and the views to take next."""
