"""Verifications as reports: words, pictures, page; and as JSON."""
