"""The cameras that could be mounted, and what each of them sees of the part among the obstacles."""
