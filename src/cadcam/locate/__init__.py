"""From photos to the pose of a part: coarse search, edges along normals, matching, covariance, quality, sequences."""
