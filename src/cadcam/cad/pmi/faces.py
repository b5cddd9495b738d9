"""The faces of a STEP file that tolerances point to: their surface, and the curves that bound them.

B-rep by ISO 10303-42: faces of closed loops of edge curves. Of each curve a few points inside it are kept, enough to
find it again among a mesh's edges; surfaces and curves of other kinds than those below keep their name only.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from cadcam.arrays import Array, Brief
from cadcam.cad.pmi.exchange import Exchange, Parameters, Ref
from cadcam.errors import UnreadableFile
from cadcam.geometry.rigid import Rigid

_AT = np.array([0.25, 0.5, 0.75])  # places along a curve that are kept
_CARRIERS = ("SURFACE_CURVE", "SEAM_CURVE", "INTERSECTION_CURVE", "BOUNDED_SURFACE_CURVE")  # of a curve in space
_ROUND = ("CIRCLE", "ELLIPSE")
_AGAIN = "export it again"
_UNKNOWN = np.full((3, 3), np.nan)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Curve(Brief):
    """An edge of the B-rep: its number in the file (in an assembly, that of its own), and points (n, 3) mm on it.

    Of an arc of a circle: centre (3,) mm, axis (3,) and radius in mm; nan of other curves.
    """

    number: int
    points: Array
    centre: Array
    axis: Array
    radius: float = float("nan")

    def moved(self, pose: Rigid, number: int) -> Curve:
        """Return the edge as an assembly has it, under another number."""
        return replace(
            self,
            number=number,
            points=pose @ self.points,
            centre=pose @ self.centre,
            axis=pose.rotation @ self.axis,
        )


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class StepFace(Brief):
    """A face: its number in the file, what its surface is ("plane", "cylinder" ...), and the curves around it.

    origin, direction (3,) mm: of the surface's axis placement; of a plane the direction is the outward normal, of a
    cylinder its axis; nan where it has none. radius: mm, of a cylinder. hole: whether the material lies outside.
    outer: how many of the curves, the first ones, are those of the outer loop.
    """

    number: int
    surface: str
    curves: tuple[Curve, ...]
    outer: int
    origin: Array
    direction: Array
    radius: float = float("nan")
    hole: bool = False

    def moved(self, pose: Rigid, further: int) -> StepFace:
        """Return the face as an assembly has it; further: added to its number and those of its curves."""
        return replace(
            self,
            number=self.number + further,
            curves=tuple(curve.moved(pose, curve.number + further) for curve in self.curves),
            origin=pose @ self.origin,
            direction=pose.rotation @ self.direction,
        )


def face_of(file: Exchange, number: int, mm: float) -> StepFace | None:
    """Return a face of a STEP file whose lengths are so many mm; None where the entity is no face."""
    entity = file[number]
    face = entity.get("ADVANCED_FACE") or entity.get("FACE_SURFACE")
    if face is None:
        return None
    loops = sorted((_loop(file, bound) for bound in face[1]), key=lambda loop: not loop[0])
    if loops and not loops[0][0]:  # no bound is said to be the outer one: the longest way round is
        loops.sort(key=lambda loop: -_extent(file, loop[1]))
    edges = [edge for _, loop in loops for edge in loop]
    surface, same = file[face[2]], face[3] == "T"
    keyword = next(iter(surface))
    position = surface[keyword][1] if len(surface[keyword]) > 1 else None
    origin, frame = placement(file, position) if isinstance(position, Ref) else (np.full(3, np.nan), _UNKNOWN)
    round_ = keyword == "CYLINDRICAL_SURFACE"
    return StepFace(
        int(number),
        keyword.lower().removesuffix("_surface").replace("cylindrical", "cylinder").replace("_", " "),
        tuple(_curve(file, edge, mm) for edge in dict.fromkeys(edges)),
        len(dict.fromkeys(loops[0][1])) if loops else 0,
        origin * mm,
        frame[:, 2] * (1.0 if same or keyword != "PLANE" else -1.0),
        float(surface[keyword][2]) * mm if round_ else float("nan"),
        round_ and not same,
    )


def curve_of(file: Exchange, number: int, mm: float) -> Curve | None:
    """Return an edge of the B-rep that a tolerance points to by itself; None where the entity is none."""
    return _curve(file, number, mm) if "EDGE_CURVE" in file[number] else None


def _loop(file: Exchange, bound: Ref) -> tuple[bool, list[Ref]]:
    """Return whether a bound is the outer one, and the edge curves of its loop."""
    entity = file[bound]
    keyword = "FACE_OUTER_BOUND" if "FACE_OUTER_BOUND" in entity else "FACE_BOUND"
    loop = file[_of(file, entity, keyword)[1]]
    oriented = loop["EDGE_LOOP"][1] if "EDGE_LOOP" in loop else []  # else a single vertex: the tip of a cone
    return keyword == "FACE_OUTER_BOUND", [_of(file, file[edge], "ORIENTED_EDGE")[3] for edge in oriented]


def _extent(file: Exchange, edges: Sequence[Ref]) -> float:
    points = np.concatenate([_curve(file, edge, 1.0).points for edge in edges]) if edges else np.zeros((1, 3))
    return float(np.linalg.norm(np.ptp(points, axis=0)))


def _curve(file: Exchange, number: Ref | int, mm: float) -> Curve:
    """Return an edge with points inside it."""
    _, first, last, geometry, same = _of(file, file[number], "EDGE_CURVE")[:5]
    a, b = (_point(file, _of(file, file[vertex], "VERTEX_POINT")[1]) for vertex in (first, last))
    if same != "T":
        a, b = b, a
    keyword, curve = _basis(file, geometry)
    if keyword in _ROUND:
        points = _on_ellipse(file, curve, a, b)
        if keyword == "CIRCLE":
            centre, frame = placement(file, curve[1])
            return Curve(int(number), points * mm, centre * mm, frame[:, 2], float(curve[2]) * mm)
    elif keyword == "LINE":
        points = a + _AT[:, None] * (b - a)
    elif keyword.startswith("B_SPLINE") or keyword == "BEZIER_CURVE":
        points = _on_spline(file, file[geometry], a, b)
    else:
        points = np.zeros((0, 3))
    return Curve(int(number), points * mm, _UNKNOWN[0], _UNKNOWN[0])


def _basis(file: Exchange, geometry: Ref) -> tuple[str, Parameters]:
    """Return keyword and parameters of a curve in space, from under those that say which surfaces it lies on."""
    for _ in range(4):
        entity = file[geometry]
        carrier = next((k for k in _CARRIERS if k in entity), None)
        if carrier is None:
            spline = next((k for k in entity if k.startswith("B_SPLINE_CURVE")), None)
            keyword = spline or next(iter(entity))
            return keyword, entity[keyword]
        geometry = entity[carrier][1]
    raise UnreadableFile(file.path, f"#{int(geometry)} is a curve on a curve on a curve", _AGAIN)


def _on_ellipse(file: Exchange, curve: Parameters, a: Array, b: Array) -> Array:
    """Return points of an arc from a to b, which runs counter-clockwise; all around where a is b."""
    origin, frame = placement(file, curve[1])
    radii = np.array([float(r) for r in curve[2:4]] * 2)[:2]
    if not (radii > 0).all():
        raise UnreadableFile(file.path, f"has a curve of radius {radii.tolist()}", _AGAIN)
    begin, end = (np.arctan2(v[1] / radii[1], v[0] / radii[0]) for v in ((p - origin) @ frame for p in (a, b)))
    turn = (end - begin) % (2 * np.pi)
    if np.linalg.norm(a - b) < 1e-9 * radii.max():
        turn = 2 * np.pi
    at = begin + _AT * turn
    return np.asarray(origin + (np.column_stack([np.cos(at), np.sin(at)]) * radii) @ frame[:, :2].T)


def _on_spline(file: Exchange, entity: dict[str, Parameters], a: Array, b: Array) -> Array:
    """Return points of a B-spline between its points next to a and b; none where its knots are not given."""
    from scipy.interpolate import BSpline

    knotted = entity.get("B_SPLINE_CURVE_WITH_KNOTS")
    if knotted is None:
        return np.zeros((0, 3))
    whole = len(knotted) > 3  # a simple entity has all parameters in one list, name first
    degree, poles = (knotted[1], knotted[2]) if whole else entity["B_SPLINE_CURVE"][:2]
    times, knots = knotted[-3], knotted[-2]
    points = np.array([_point(file, pole) for pole in poles])
    weights = np.array(
        entity["RATIONAL_B_SPLINE_CURVE"][0] if "RATIONAL_B_SPLINE_CURVE" in entity else [1.0] * len(points)
    )
    t = np.repeat(np.asarray(knots, float), np.asarray(times, int))
    homogeneous = np.column_stack([points * weights[:, None], weights])
    spline = BSpline(t, homogeneous, int(degree), extrapolate=False)
    u = np.linspace(t[int(degree)], t[-int(degree) - 1], 201)
    at = spline(u)
    every = at[:, :3] / at[:, 3:]
    first, last = (int(np.linalg.norm(every - p, axis=1).argmin()) for p in (a, b))
    if first >= last:  # closed, or cut at its seam
        first, last = 0, len(u) - 1
    return np.asarray(every[np.round(first + _AT * (last - first)).astype(int)])


def placement(file: Exchange, number: Ref) -> tuple[Array, Array]:
    """Return origin (3,) and axes (3, 3), its columns x, y, z, of a placement."""
    _, location, axis, reference = [*_of(file, file[number], "AXIS2_PLACEMENT_3D"), None][:4]
    z = _direction(file, axis) if axis else np.array([0.0, 0.0, 1.0])
    x = _direction(file, reference) if reference else np.array([1.0, 0.0, 0.0])
    x = x - z * (x @ z)
    if np.linalg.norm(x) < 1e-9:
        x = np.linalg.svd(z[None])[2][1]
    x = x / np.linalg.norm(x)
    return _point(file, location), np.column_stack([x, np.cross(z, x), z])


def _direction(file: Exchange, number: Ref) -> Array:
    d = np.array(_of(file, file[number], "DIRECTION")[1], float)
    size = float(np.linalg.norm(d))
    if d.shape != (3,) or not size > 0:
        raise UnreadableFile(file.path, f"#{int(number)} is no direction: {d.tolist()}", _AGAIN)
    return np.asarray(d / size)


def _point(file: Exchange, number: Ref) -> Array:
    p = np.array(_of(file, file[number], "CARTESIAN_POINT")[1], float)
    if p.shape != (3,):
        raise UnreadableFile(file.path, f"#{int(number)} is no point in space: {p.tolist()}", _AGAIN)
    return p


def _of(file: Exchange, entity: dict[str, Parameters], keyword: str) -> Parameters:
    """Return the parameters of an entity that has to be of this kind."""
    if keyword not in entity:
        raise UnreadableFile(file.path, f"has {' '.join(entity)} where a {keyword} is expected", _AGAIN)
    return entity[keyword]
