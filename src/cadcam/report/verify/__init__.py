"""Verifications for a person: words, pictures, page; and as JSON."""
