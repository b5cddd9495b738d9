"""What a part looks like from every direction, in which poses the same, and from where it may be seen."""
