"""From photos to the pose of a part: search, refinement by edges, template matching, quality, tracking."""
