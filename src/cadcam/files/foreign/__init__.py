"""Other programs' camera files: one file per family, each the only place that knows its conventions.

`registry` finds the format of a file and reads or writes it; `model` defines what a format is; `losses` finds what it
cannot hold. Every reader returns our conventions (pixel centres at integers, x right, y down, z forward, mm).
"""
