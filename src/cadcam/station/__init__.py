"""A station that measures: a camera carried over a plane, calibrated at a grid of positions, checked against itself."""
