"""What photos show along the edges of a located part: places on them, their light, the edge found for each."""
