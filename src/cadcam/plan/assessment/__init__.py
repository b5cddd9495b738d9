"""What is asked of features, and what cameras together answer: uncertainties, their causes, ratios to the limits."""
