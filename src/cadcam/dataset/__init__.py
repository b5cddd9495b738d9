"""Labelled synthetic pictures of a part, at any scale: planned, made on many processes, written for others to read."""
