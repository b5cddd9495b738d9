"""Estimation of cameras and poses from observations, with their covariance."""
