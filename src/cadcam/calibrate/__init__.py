"""From observations to a camera or a pose with its covariance."""
