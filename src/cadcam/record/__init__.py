"""The product state: the measurements of each produced part, kept for the next station and later questions."""
