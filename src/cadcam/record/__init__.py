"""The product state: what each produced part measured, kept for the next station and later questions."""
