"""What a layout is planned from: the part's features with limits, cameras, where they may be; and its file."""
