"""A body that is turned in the browser, for pages that load nothing."""
