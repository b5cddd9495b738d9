"""The C core and the modules that load it."""
