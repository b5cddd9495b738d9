"""Windows of the drawn part found in a photo: chosen, correlated, made consistent; how close edges lie."""
