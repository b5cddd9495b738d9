"""From a rough start or none to poses that are worth refining."""
