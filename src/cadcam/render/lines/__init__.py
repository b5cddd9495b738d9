"""The visible wireframe: which lines a view has, what hides them, and what is left as polylines."""
