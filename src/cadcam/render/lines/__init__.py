"""The visible wireframe: the lines of a view, their occlusion, and the visible parts as polylines."""
