"""Tracking: a part followed through frames by its edges, its motion and its surface texture; the log of a run."""
