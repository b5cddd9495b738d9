"""OpenGL without a window: the face seen at each pixel centre, found by the GPU."""
