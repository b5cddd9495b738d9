"""Single marks: what they look like, found in a picture and fitted to its grey values."""
