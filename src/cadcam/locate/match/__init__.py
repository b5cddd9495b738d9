"""Template matching: salient windows of the drawn part, their peaks in photos, and the pose they agree on."""
