"""A page on which a person picks corners of a CAD model in a photo."""
