"""The jobs of `cadcam station`."""
