"""A station's calibration and measurements as reports: tables, plots, page."""
