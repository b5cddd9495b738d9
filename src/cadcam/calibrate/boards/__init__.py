"""A camera from pictures of a calibration board: found, checked, calibrated; what they cover, which to take next."""
