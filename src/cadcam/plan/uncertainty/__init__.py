"""The uncertainty of features in pictures, and of points measured from these: sums of 3x3 information."""
