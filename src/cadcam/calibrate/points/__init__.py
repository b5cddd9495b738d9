"""A camera from points of one picture: in full, in part, its pose alone, or of a lower dimension."""
