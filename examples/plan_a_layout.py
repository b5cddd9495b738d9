"""Plan cameras before there is a factory: four fixed ones around a ship's block, and six stations of one on a robot.

Run it as `python examples/plan_a_layout.py [FOLDER]`: the scenes and their CAD model are written there, to be edited,
and uncertainty.jpg: the block in the colours of the uncertainty with which the fixed cameras will measure a point.
"""

from __future__ import annotations

import sys
from pathlib import Path

import cadcam
from cadcam.plan.coverage import coverage
from cadcam.plan.pictures import coverage_pictures
from cadcam.plan.scene.samples import write_samples
from cadcam.report.layout.words import layout_tables, next_table
from cadcam.report.table import show


def main(folder: str) -> None:
    """Plan both scenes; print what they measure, what if, and which camera would come next."""
    _, fixed, robot = write_samples(Path(folder))
    for scene in (fixed, robot):
        layout = cadcam.plan_layout(cadcam.read_layout_scene(scene))
        following = cadcam.next_cameras(layout.survey, layout.chosen)
        tables = [
            *layout_tables(layout, cadcam.what_if(layout)),
            next_table(layout.survey, layout.chosen, following, most=3),
        ]
        show(tables, sys.stdout)
        if scene == fixed:
            paint(layout, Path(folder) / "uncertainty.jpg")


def paint(layout: cadcam.Layout, path: Path) -> None:
    """Write a picture of the part, each place in the colour of its predicted uncertainty; say what the colours mean."""
    painting = coverage(layout).measured()
    if painting is not None:
        (_, picture), _ = coverage_pictures(layout, painting)
        cadcam.write_picture(path, picture, quality=82)
        print(f"wrote {path}: {'; '.join(painting.words)}")


if __name__ == "__main__":
    main(*sys.argv[1:] or ["scenes"])
