"""One camera from several positions with shared internals; which parameters the views need, and held-out errors."""
