"""What photos show along the edges of a located part: places on them, lighting, the edge found for each."""
