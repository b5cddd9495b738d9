"""Planning before anything is installed: which cameras to mount where, and how well they will measure."""
