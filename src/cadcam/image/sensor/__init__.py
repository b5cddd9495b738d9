"""What a camera does to a picture between the scene and the file: effects, each with its equation, and profiles."""
