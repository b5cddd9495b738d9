"""The variability of a calibrated camera's parameters: by draws, by chains, and with alternating poses."""
