"""From a located part to a verdict: tolerances, signed deviations with their uncertainty, PASS, FAIL or UNDECIDED."""
