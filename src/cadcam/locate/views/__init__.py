"""A part's views: what it shows from every direction, in which poses it looks alike, and which views to expect."""
