"""Points in space from what calibrated cameras saw, with all their uncertainty; inputs read wrongly are named."""
