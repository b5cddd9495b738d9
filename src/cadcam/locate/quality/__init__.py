"""Is the part really there? What speaks for a pose beyond chance, and what speaks against it."""
