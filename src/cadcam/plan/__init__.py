"""Before there is a factory: what cameras at which places will measure, how well, and which of them to buy."""
