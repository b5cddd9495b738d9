"""From a start nearby to the pose at the limit of the pixels, with its covariance."""
