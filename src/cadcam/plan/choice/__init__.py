"""Which k cameras to take: how good a set is, and the search for the best."""
