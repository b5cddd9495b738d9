"""Pictures and visible edges of a scene through a camera."""
