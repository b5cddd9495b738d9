"""A block of a ship's double bottom: plates, stiffeners through their cut-outs, brackets, a pipe."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import numpy as np

from cadcam.arrays import Array, Longs
from cadcam.cad.mesh import Mesh, merge
from cadcam.cad.parts.shape import (
    Color,
    arc,
    box,
    circle,
    extruded,
    filled,
    moved,
    named,
    prism,
    rounded,
    tube,
    turned,
)
from cadcam.errors import BadValue

# Thicknesses and heights in mm, typical of rule books and yards for a block of this size.
TANK_TOP, FLOOR, GIRDER, SHELL, BAR = 12.0, 10.0, 14.0, 14.0, 10.0
WEB_HEIGHT, FLANGE_WIDTH = 200.0, 90.0
SLOT_HEIGHT, SLOT_WIDTH, SLOT_RADIUS = 240.0, 120.0, 30.0
SCALLOP = 60.0
PIPE_OUT, PIPE_IN, PIPE_HOLE, BEND = 110.0, 102.0, 140.0, 330.0
FLANGE_GAP = 1.5  # a slip-on flange clears the pipe, however coarse the two are
PLATE: Color = (0.55, 0.32, 0.26)
PROFILE: Color = (0.62, 0.40, 0.32)
PIPE: Color = (0.45, 0.50, 0.55)
LEAST, MOST = 5_000, 2_000_000
STEEL_SHARE = 0.65
_CHOICES = ((30_000, (3, 2)), (300_000, (5, 3)), (600_000, (7, 4)), (MOST + 1, (14, 4)))  # floors, columns of a panel
NARROWEST = 320.0  # between longitudinals: room for the hole of the pipe
SHORTEST = 1.0  # mm: approximate lower limit for the sides of arcs
Cell = tuple[Array, Longs]


@dataclass(frozen=True, slots=True)
class _Plan:
    """The parameters of a block: its size, the number of floors and longitudinals, the resolution of its cut-outs."""

    length: float
    breadth: float
    height: float
    floors: int
    columns: int
    q: int  # sides per quarter circle

    def arc_sides(self, radius: float) -> int:
        """Return the number of sides to a quarter circle of this radius."""
        return max(min(self.q, int(radius * np.pi / 2 / SHORTEST)), 3)

    @property
    def stations(self) -> Array:
        """The x of the middle of each floor."""
        return np.asarray(self.length * (np.arange(self.floors) + 0.5) / self.floors)

    @property
    def panels(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """The y range of the floors, on the port (open) and the starboard side."""
        middle = self.breadth / 2
        return (0.0, middle - GIRDER / 2), (middle + GIRDER / 2, self.breadth - GIRDER)

    @property
    def depth(self) -> float:
        """Height of floors and girders, between tank top and shell."""
        return self.height - TANK_TOP - SHELL

    @property
    def row(self) -> float:
        """Height of the strips at both ends of a floor that hold the slots."""
        return SLOT_HEIGHT + 80.0


def ship_block(*, triangles: int = 10_000, size: tuple[float, float, float] = (4000.0, 3000.0, 2000.0)) -> Mesh:
    """Return a double-bottom block of `size` (x, y, z) mm with about the given number of triangles (within 10 %).

    It stands on its tank top, as built: floors across, two girders along, the shell over the starboard half only, so
    that one sees inside. Every plate is a closed solid of 10 to 14 mm; longitudinals (angle bars) run through slots
    with rounded corners and touch one side of them; floors have scallops in their corners and lightening holes;
    brackets and flat bars stiffen them; a pipe with a bend and bolted flanges runs through the port side. More
    triangles come from more floors and longitudinals and rounder cut-outs, scallops, profiles and pipe. Raises
    `BadValue` outside 5 000 to 2 000 000 triangles or below 2 x 2 x 1.2 m.
    """
    if not LEAST <= triangles <= MOST:
        raise BadValue("triangles", triangles, f"{LEAST} to {MOST}")
    if not (np.isfinite(size).all() and size[0] >= 2000 and size[1] >= 2000 and size[2] >= 1200):
        raise BadValue("size of the ship block", size, "at least 2000 x 2000 x 1200 mm")
    plan = _plan(triangles, size)
    steel = _steel(plan)
    return merge([*steel, *_piping(plan, triangles - sum(part.n_faces for part in steel))])


def _plan(triangles: int, size: tuple[float, float, float]) -> _Plan:
    """Choose the plan whose steel takes about three quarters of the triangles."""
    floors, columns = next(choice for most, choice in _CHOICES if triangles < most)
    columns = min(columns, int((size[1] - GIRDER) / 2 / NARROWEST))

    def plan(q: int) -> _Plan:
        return _Plan(float(size[0]), float(size[1]), float(size[2]), floors, columns, q)

    def count(q: int) -> int:
        return sum(part.n_faces for part in _steel(plan(q)))

    wanted = STEEL_SHARE * triangles
    low, high = 3, 4
    at_low, at_high = count(low), count(high)
    for _ in range(4):  # the count grows with q, ever more slowly as small radii reach the lower limit
        guess = max(int(low + (wanted - at_low) * (high - low) / max(at_high - at_low, 1)), 3)
        if guess in (low, high):
            break
        low, at_low, high, at_high = high, at_high, guess, count(guess)
    return plan(high if abs(at_high - wanted) < abs(at_low - wanted) else low)


def _steel(plan: _Plan) -> list[Mesh]:
    parts = [box((0, 0, 0), (plan.length, plan.breadth, TANK_TOP), name="tank top", color=PLATE)]
    parts.append(
        box(
            (0, plan.breadth / 2 - GIRDER / 2, plan.height - SHELL),
            (plan.length, plan.breadth, plan.height),
            name="bottom shell",
            color=PLATE,
        )
    )
    girder = _girder(plan)
    parts.append(moved(named(girder, "centre girder"), (0, plan.breadth / 2 + GIRDER / 2, TANK_TOP)))
    parts.append(moved(named(girder, "side girder"), (0, plan.breadth, TANK_TOP)))
    for side, (start, end) in zip(("port", "starboard"), plan.panels, strict=True):
        parts += _panel(plan, side, start, end)
    return parts


def _panel(plan: _Plan, side: str, start: float, end: float) -> list[Mesh]:
    """Return the floors of one side with everything on them, and the longitudinals that run through."""
    pitch = (end - start) / plan.columns
    floor = _floor(plan, end - start, upper_slots=side == "starboard", pipe=side == "port")
    bar, bracket = _flat_bar(plan), _bracket(plan)
    parts = []
    for i, x in enumerate(plan.stations, 1):
        parts.append(moved(named(floor, f"floor {i} {side}"), (x - FLOOR / 2, start, TANK_TOP)))
        for j in range(1, plan.columns):
            y = start + j * pitch + BAR / 2
            parts.append(moved(named(bar, f"bar {i}.{j} {side}"), (x + FLOOR / 2, y, TANK_TOP)))
            parts.append(moved(named(bracket, f"bracket {i}.{j} {side}"), (x - FLOOR / 2, y, TANK_TOP)))
    profile = _longitudinal(plan)
    for j in range(plan.columns):
        y = start + (j + 0.5) * pitch
        parts.append(moved(named(profile, f"longitudinal {j + 1} {side}"), (0, y, TANK_TOP)))
        if side == "starboard":
            upper = turned(named(_longitudinal(plan, hanging=True), f"shell longitudinal {j + 1} {side}"), "xy")
            parts.append(moved(upper, (0, y, plan.height - SHELL)))
    return parts


def _floor(plan: _Plan, width: float, *, upper_slots: bool, pipe: bool) -> Mesh:
    """Return a floor with its corner at the origin: x across its thickness, y along, z up."""
    pitch = width / plan.columns
    cells: list[Cell] = []
    for j in range(plan.columns):
        u0 = j * pitch
        ends = (j == 0, j == plan.columns - 1)
        lower, middle = _end_cell(plan, pitch, ends, True), _middle_cell(plan, pitch, pipe and j == 0)
        upper = _end_cell(plan, pitch, ends, upper_slots)
        cells.append((lower[0] + (u0, 0), lower[1]))
        cells.append((middle[0] + (u0, 0), middle[1]))
        cells.append((upper[0] * (1, -1) + (u0, plan.depth), upper[1][:, ::-1]))
    return turned(extruded(cells, 0, FLOOR, name="floor", color=PLATE), "yz")


@lru_cache(maxsize=64)
def _end_cell(plan: _Plan, pitch: float, ends: tuple[bool, bool], slot: bool) -> Cell:
    """Return the strip of one column at the lower end of a floor: slot in its middle, scallops at the panel's ends."""
    line: list[Array] = [arc((0, 0), SCALLOP, 90, 0, plan.arc_sides(SCALLOP)) if ends[0] else np.array([[0.0, 0.0]])]
    if slot:
        left = pitch / 2 - BAR / 2
        right, top, r = left + SLOT_WIDTH, SLOT_HEIGHT, SLOT_RADIUS
        line += [np.array([[left, 0.0]]), arc((left + r, top - r), r, 180, 90, plan.arc_sides(r))]
        line += [arc((right - r, top - r), r, 90, 0, plan.arc_sides(r)), np.array([[right, 0.0]])]
    line.append(arc((pitch, 0), SCALLOP, 180, 90, plan.arc_sides(SCALLOP)) if ends[1] else np.array([[pitch, 0.0]]))
    return filled(np.concatenate([*line, [[pitch, plan.row], [0.0, plan.row]]]))


@lru_cache(maxsize=64)
def _middle_cell(plan: _Plan, pitch: float, round_hole: bool) -> Cell:
    """Return the middle of one column of a floor: a lightening hole, or the hole for the pipe."""
    low, high = plan.row, plan.depth - plan.row
    centre = (pitch / 2, (low + high) / 2)
    if round_hole:
        hole = circle(centre, PIPE_HOLE, 4 * plan.arc_sides(PIPE_HOLE))
    else:
        half = 0.27 * pitch, 0.33 * (high - low)
        hole = _oval(plan, centre, half)
    return filled([(0, low), (pitch, low), (pitch, high), (0, high)], [hole])


def _oval(plan: _Plan, centre: tuple[float, float], half: tuple[float, float]) -> Array:
    radius = 0.9 * min(half)
    (x, y), (a, b) = centre, half
    return rounded((x - a, y - b), (x + a, y + b), radius, plan.arc_sides(radius))


def _girder(plan: _Plan) -> Mesh:
    """Return a girder along x from the origin, up along z, its far side at y = 0; a manhole between any two floors."""
    lines = [0.0, *plan.stations, plan.length]
    cells = []
    for x0, x1 in pairwise(lines):
        centre = ((x0 + x1) / 2, plan.depth / 2)
        half = 0.28 * min(x1 - x0, 1200.0), 0.2 * plan.depth
        cells.append(filled([(x0, 0), (x1, 0), (x1, plan.depth), (x0, plan.depth)], [_oval(plan, centre, half)]))
    return turned(extruded(cells, 0, GIRDER, name="girder", color=PLATE), "xz")


def _longitudinal(plan: _Plan, *, hanging: bool = False) -> Mesh:
    """Return an angle bar along x: its web about y = 0, its foot at z = 0, its flange towards +y."""
    h, t, b, r, toe = WEB_HEIGHT, BAR, FLANGE_WIDTH, 14.0, 6.0
    w = t / 2
    outline = np.concatenate(
        [
            [[-w, 0], [w, 0]],
            arc((w + r, h - t - r), r, 180, 90, plan.arc_sides(r)),
            arc((b - w - toe, h - t + toe), toe, -90, 0, plan.arc_sides(toe)),
            [[b - w, h], [-w, h]],
        ]
    )
    if hanging:
        outline = (outline * (1, -1))[::-1]
    return turned(prism(outline, 0, plan.length, name="longitudinal", color=PROFILE), "yz")


def _flat_bar(plan: _Plan) -> Mesh:
    """Return an upright flat bar on a floor, sniped at its ends: x away from the floor, its far side at y = 0."""
    h = plan.depth
    outline = [(0.0, 40.0), (100.0, 120.0), (100.0, h - 120.0), (0.0, h - 40.0)]
    return turned(prism(outline, 0, BAR, name="bar", color=PROFILE), "xz")


def _bracket(plan: _Plan) -> Mesh:
    """Return a knee between floor and tank top, reaching to -x and up; a scallop at its heel, rounded in its hollow."""
    leg, rise, nose, r = 250.0, 300.0, 20.0, 40.0
    hollow = arc((-leg, rise), 1.0, -90, 0, 2 * plan.arc_sides(leg)) - (-leg, rise)
    curve = np.array([-leg, rise]) + hollow * (leg - nose, rise - nose)
    outline = np.concatenate(
        [
            arc((0, 0), r, 180, 90, plan.arc_sides(r)),
            [[0, rise], [-nose, rise]],
            curve[::-1][1:-1],
            [[-leg, nose], [-leg, 0]],
        ]
    )
    return turned(prism(outline, 0, BAR, name="bracket", color=PROFILE), "xz")


def _piping(plan: _Plan, triangles: int) -> list[Mesh]:
    """Return the pipe and its flanges, the pipe as round as the remaining triangles allow."""
    start, end = plan.panels[0]
    y = start + (end - start) / plan.columns / 2
    z = TANK_TOP + plan.depth / 2
    flange = _flange(plan.arc_sides(PIPE_OUT))
    left = max(triangles - 2 * flange.n_faces, 0)
    n = 12
    while _pipe_faces(n + 2) <= left:
        n += 2
    line = _spine(plan, y, z, _bends(n))
    pipe = tube(line, np.array([0.0, 1.0, 0.0]), (PIPE_OUT, PIPE_IN), n, name="pipe", color=PIPE)
    first = moved(turned(named(flange, "flange 1"), "yz"), line[0])
    last = moved(named(flange, "flange 2"), line[-1] - (0, 0, 20))
    return [pipe, first, last]


def _bends(n: int) -> int:
    return max(n // 4, 4)


def _pipe_faces(n: int) -> int:
    return 4 * n * (_bends(n) + 2) + 4 * n


def _spine(plan: _Plan, y: float, z: float, bends: int) -> Array:
    """Return the middle line of the pipe: along x, round a bend between the last two floors, and up."""
    x = float(plan.stations[-2:].mean()) - BEND
    curve = arc((x, z + BEND), BEND, -90, 0, bends)
    flat = np.concatenate([[[-200.0, z]], curve, [[x + BEND, plan.height + 200.0]]])
    return np.column_stack([flat[:, 0], np.full(len(flat), y), flat[:, 1]])


def _flange(q: int) -> Mesh:
    """Return a ring with eight bolts about the z axis, from z = 0 up."""
    bolts = [(140 * np.cos(t), 140 * np.sin(t)) for t in np.pi * (np.arange(8) + 0.5) / 4]
    bore = (PIPE_OUT + FLANGE_GAP) / np.cos(np.pi / (4 * q))
    holes = [circle((0, 0), bore, 4 * q), *(circle(bolt, 11, max(q, 12)) for bolt in bolts)]
    ring = extruded([filled(circle((0, 0), 170, 4 * q), holes)], 0, 20, name="ring", color=PIPE)
    solids = [ring]
    for bolt in bolts:
        solids.append(prism(circle(bolt, 17, 6), 20, 32, name="head", color=PIPE))
        solids.append(prism(circle(bolt, 17, 6), -12, 0, name="nut", color=PIPE))
    whole = merge(solids)
    return Mesh(whole.vertices, whole.faces, whole.part * 0, whole.surface, ("flange",), whole.part_colors[:1])
