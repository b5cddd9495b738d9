"""What a photo shows along the part's visible lines: samples, cells, the steps in these, bands beside the lines."""
