"""What a photo shows along the part's visible lines: samples on them, cells, the steps in these, bands beside them."""
