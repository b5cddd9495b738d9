"""Layouts as reports: words, plan, page; and as JSON."""
