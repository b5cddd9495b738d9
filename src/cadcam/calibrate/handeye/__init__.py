"""Hand-eye calibration: the pose of a camera on a robot's flange or in its cell."""
