"""Pixels: reading and writing pictures, edges in them, lines drawn on them."""
