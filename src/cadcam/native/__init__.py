"""The C core and the one module that loads it."""
