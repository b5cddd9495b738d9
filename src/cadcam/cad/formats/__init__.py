"""One reader for each family of formats; every one returns a `Model` in the units of its file."""
