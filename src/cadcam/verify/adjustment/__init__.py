"""The pose fitted to datum edges, with errors of edges as they are: scatter, feet that follow, how sure an alarm is."""
