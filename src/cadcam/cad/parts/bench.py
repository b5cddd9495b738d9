"""The calibration bench of the dissertation: ring targets at the points of its Table 2.3."""

from __future__ import annotations

import numpy as np

from cadcam.arrays import Array
from cadcam.cad.mesh import Mesh, merge
from cadcam.cad.parts.shape import between, box, circle, extruded, filled, joined, level, moved, named
from cadcam.kinds import expect_known

# Table 2.3: X, Y, Z in mm, eight targets at each of two distances; the camera stands near (8, 416, -210).
BENCH_POINTS: Array = np.array(
    [
        [x, y, z]
        for z in (-1040.0, -1410.0)
        for x, y in ((0, 80), (10, 220), (10, 400), (100, 140), (110, 300), (220, 230), (250, 80), (290, 400))
    ]
)
BENCH_POINTS.setflags(write=False)

# Radii in mm. The marks are a third of those at the yard, which are 120 mm across (section 6.3.3): a dot, white, ring,
# and a narrow white margin.
DOT, RING_IN, RING_OUT, DISC = 6.0, 12.0, 20.0, 21.5
THICK, ARM = 3.0, 6.0
BLACK, WHITE, GREY, STEEL = (0.05, 0.05, 0.05), (0.95, 0.95, 0.95), (0.45, 0.5, 0.55), (0.6, 0.62, 0.65)
RAILS = {"left": -90.0, "right": 380.0}
ARMS_LEFT = (0, 1, 2, 3, 4)  # near targets held from the left: no arm then crosses the view of a far target


def calibration_bench(*, targets: str = "both", sides: int = 48) -> Mesh:
    """Return the bench in mm, in the frame of Table 2.3, its targets facing +z with their centres at `BENCH_POINTS`.

    Each target is a closed disc of 3 mm whose flat front is parted into "target N dot" and "target N ring" (black) and
    "target N disc" (white, with the back), N from 1 in the order of the table. `targets` is "near" (z = -1040),
    "far" (z = -1410) or "both": the dissertation moved one board between two pictures, here both stand at once as in
    its Fig 3-3. From its camera only target 11 is then hidden, behind target 3 (their images are 4 pixels apart in
    Table 2.3). `sides` is the number of sides of each circle. Raises `UnknownName`.
    """
    chosen = {"near": range(8), "far": range(8, 16), "both": range(16)}
    expect_known(targets, "targets", chosen)
    target = _target(sides)
    parts = [
        named(moved(part, BENCH_POINTS[k]), f"target {k + 1} {what}")
        for k in chosen[targets]
        for what, part in target.items()
    ]
    if targets != "far":
        parts += _near_frame()
    if targets != "near":
        parts.append(box((-140, -20, -1410 - THICK - 15), (430, 480, -1410 - THICK), name="board", color=GREY))
    return merge(parts)


def _target(sides: int) -> dict[str, Mesh]:
    """Return dot, ring and disc of a target around the origin; dot and ring are sheets in its front, rim to rim."""
    dot, ring_in, ring_out, rim = (circle((0, 0), radius, sides) for radius in (DOT, RING_IN, RING_OUT, DISC))
    white = [level(filled(ring_in, [dot]), 0, 0), level(filled(rim, [ring_out]), 0, 0)]
    back = level(filled(rim), -THICK, 1, down=True)
    wall = between(_at(rim, -THICK), _at(rim, 0.0), 2)
    return {
        "dot": joined([level(filled(dot), 0, 0)], name="dot", color=BLACK),
        "ring": joined([level(filled(ring_out, [ring_in]), 0, 0)], name="ring", color=BLACK),
        "disc": joined([*white, back, wall], name="disc", color=WHITE),
    }


def _at(loop: Array, z: float) -> Array:
    return np.column_stack([loop, np.full(len(loop), z)])


def _near_frame() -> list[Mesh]:
    """Return the rails, the arms that hold the near targets from behind, and the rods from the rails to the board."""
    back = -1040.0 - THICK
    board = -1410.0 - THICK
    parts = []
    for side, x in RAILS.items():
        rail = ((x - 10, -20, back - ARM - 20), (x + 10, 480, back - ARM))
        parts.append(box(*rail, name=f"{side} rail", color=STEEL))
        for end, y in (("lower", 0.0), ("upper", 460.0)):
            rod = extruded(
                [filled(circle((x, y), 6, 24))], board, back - ARM - 20, name=f"{side} {end} rod", color=STEEL
            )
            parts.append(rod)
    for k, (x, y, _) in enumerate(BENCH_POINTS[:8].tolist()):
        ends = (RAILS["left"] - 10, x + 10) if k in ARMS_LEFT else (x - 10, RAILS["right"] + 10)
        parts.append(box((ends[0], y - 2, back - ARM), (ends[1], y + 2, back), name=f"arm {k + 1}", color=STEEL))
    return parts
