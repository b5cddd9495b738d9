"""Labelled synthetic pictures of a part, at any scale: planned, rendered by many processes, written in open formats."""
