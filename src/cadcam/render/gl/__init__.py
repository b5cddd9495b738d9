"""OpenGL without a window: which face each pixel centre sees, found by the GPU."""
