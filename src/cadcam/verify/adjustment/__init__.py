"""The pose fitted to datum edges: errors common to an edge, feet that follow, the significance of an alarm."""
