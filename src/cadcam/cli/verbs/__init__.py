"""One file a verb: its options, one library call, what is printed."""
