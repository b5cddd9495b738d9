"""Is the part really there? The evidence for a pose beyond chance, and the evidence against it."""
