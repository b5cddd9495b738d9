"""One file per verb: its options, one library call, the output."""
