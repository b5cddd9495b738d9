"""From a nearby start to the pose at the limit of the pixels, with its covariance."""
