"""What a station's calibration and measurements say: tables, plots, page."""
