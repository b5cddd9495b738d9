"""Results as text a person reads: all formatting of mm, px and degrees lives here."""
