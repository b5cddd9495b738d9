"""Single marks: their geometry, detection in a picture and fit to the grey values."""
