"""Layouts for a person: words, plan, page; and as JSON."""
