"""The search for starting poses, from a rough start or from none, for edge refinement to take up."""
