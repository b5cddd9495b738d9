"""Other programs' camera files: one file a family, each the only place that knows its conventions.

`registry` finds the format of a file and reads or writes it; `model` says what a format is; `losses` what it cannot
hold. Every reader returns our conventions (pixel centres at integers, x right, y down, z forward, mm).
"""
