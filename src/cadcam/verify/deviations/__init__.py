"""Deviations of edges and features from the CAD, their uncertainty, and what may lead edges astray."""
