"""One reader for each family of files; every one returns a `Model` in the units of its file."""
