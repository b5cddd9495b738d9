"""Identification of marks: found marks assigned to the places of a plan."""
