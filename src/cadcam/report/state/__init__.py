"""What a store holds of many parts as reports: tables, charts, page."""
