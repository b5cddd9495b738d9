"""The contents of a data set, as a table."""

from __future__ import annotations

import statistics

from cadcam.dataset.make import Made
from cadcam.report.table import Table

_LITTLE = 0.1  # less visible objects are left out of BOP's evaluation


def summary(made: Made) -> Table:
    """Return the table of a run: views, how much of the part they show, files."""
    seen = [share for share in made.visible if share > 0]
    rows = [
        ("views", str(len(made.visible))),
        ("  made now", str(made.new)),
        ("  that show nothing of the part", str(len(made.visible) - len(seen))),
        ("  that show less than a tenth of it", str(sum(share < _LITTLE for share in seen))),
        ("visible share of the part, median", f"{statistics.median(seen):.2f}" if seen else "-"),
        ("depth_scale, mm a step", f"{made.depth_step:g}"),
        ("BOP scenes", f"{made.scenes[0]}" + (f" to {made.scenes[-1].name}" if len(made.scenes) > 1 else "")),
        ("COCO", str(made.folder / made.layout.coco)),
    ]
    return Table("Data set", ("", ""), tuple(rows), ("",))
