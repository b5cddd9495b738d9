"""What a drawing asks: limits of features, the file that states them, and the decision by ISO 14253-1."""
