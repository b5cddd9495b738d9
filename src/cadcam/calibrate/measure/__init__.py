"""Points in space from the pixels of calibrated cameras, with all their uncertainty; misread inputs are named."""
