"""cadcam's own files: cameras, poses and points."""
