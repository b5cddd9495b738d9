"""What a STEP file says beside its shape: semantic PMI (ISO 10303-242), the tolerances of the drawing."""
