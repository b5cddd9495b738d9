"""Which mark is which: found marks put into the order of a plan."""
