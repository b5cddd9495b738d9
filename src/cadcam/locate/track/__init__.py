"""A part followed through pictures: its motion, the print on it, the log of where it was."""
