"""One camera from several positions, its internals shared; which of them the views ask for, and what it is worth."""
