"""The built-in demonstration: what it is given, the block as built, what came out beside the truth."""
