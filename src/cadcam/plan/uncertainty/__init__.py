"""How well features are found in pictures, and what pictures then tell of points: sums of 3x3 information."""
