"""Solvers: linear seeds, pose from points, least squares with covariance."""
