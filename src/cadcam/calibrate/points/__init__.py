"""A camera from points of one picture: in full, in part, its pose alone, or in lower dimensions."""
