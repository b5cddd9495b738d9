"""The built-in demonstration: its inputs, the block as built, the results beside the truth."""
