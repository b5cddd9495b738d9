"""How stable the parameters of a calibrated camera are: by draws, by chains, where it stands elsewhere each time."""
