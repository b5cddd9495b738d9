"""What has to be measured: points, marks and holes, edges of the part, each with the limits of a tolerance file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np

from cadcam.arrays import Array, Longs, Mask, frozen
from cadcam.errors import BadValue
from cadcam.render.view import Scene
from cadcam.verify.tolerances.tolerance import Limit, Quantity, Selection

_RIM = 8  # places on a circle's rim that have to be seen
_STATIONS = 9  # on a straight edge
_MOST_STATIONS = 48  # on the edges of a selection
_PARALLEL = 1 - 1e-6


class Kind(Enum):
    """How a feature is measured in a picture: where it is; by its outline; across itself."""

    POINT = "point"
    CIRCLE = "circle"
    EDGE = "edge"


@dataclass(frozen=True, slots=True, eq=False)
class LayoutFeature:
    """A feature in the part frame, mm, and what is asked of it.

    p (3,): the point, the circle's centre or the middle of the edges. normal (3,): unit vector out of the surface, from
    where alone it is seen; None: any side. segments (S, 2, 3): straight pieces of edges. plane_mm: how well the height
    of the known plane that it lies on is known, along its normal; None: it lies on none, and two cameras are needed.
    """

    name: str
    kind: Kind
    p: Array
    limits: tuple[Limit, ...]
    normal: Array | None = None
    diameter_mm: float | None = None
    segments: Array | None = None
    plane_mm: float | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "p", frozen(self.p, f"place of {self.name}", (3,)))
        if self.normal is not None:
            n = frozen(self.normal, f"normal of {self.name}", (3,))
            if not np.linalg.norm(n) > 0:
                raise BadValue(f"normal of {self.name}", n.tolist(), "a vector that is not zero")
            object.__setattr__(self, "normal", frozen(n / np.linalg.norm(n), "normal", (3,)))
        if self.diameter_mm is not None and not (np.isfinite(self.diameter_mm) and self.diameter_mm > 0):
            raise BadValue(f"diameter of {self.name}", f"{self.diameter_mm:g} mm", "a positive number")
        if self.kind is Kind.CIRCLE and (self.normal is None or self.diameter_mm is None):
            raise BadValue(f"circle {self.name}", "without normal or diameter_mm", "both")
        if self.plane_mm is not None and not (self.normal is not None and self.plane_mm > 0):
            raise BadValue(f"known plane of {self.name}", "without a normal, or not above 0 mm", "both")
        for limit in self.limits:
            if limit.quantity not in (Quantity.POSITION, Quantity.ANGLE):
                raise BadValue(f"limit of {self.name}", limit.quantity.value, "position_mm or angle_deg")
            if limit.quantity is Quantity.ANGLE and not self.straight:
                raise BadValue(f"angle_deg of {self.name}", "asked of what has no direction", "an edge_mm to ask it of")

    @classmethod
    def edge(cls, name: str, ends: Array, limits: tuple[Limit, ...]) -> LayoutFeature:
        """Return a straight edge between two ends (2, 3) mm."""
        a, b = frozen(ends, f"ends of {name}", (2, 3))
        if not np.linalg.norm(b - a) > 0:
            raise BadValue(f"ends of {name}", a.tolist(), "two different points")
        return cls(name, Kind.EDGE, (a + b) / 2, limits, segments=np.array([[a, b]]))

    @classmethod
    def selected(cls, name: str, selection: Selection, scene: Scene, limits: tuple[Limit, ...]) -> LayoutFeature:
        """Return edges of the part, chosen as in a tolerance file, that are measured as one."""
        selection.check(scene)
        edges = scene.edges
        ends = scene.mesh.vertices[edges.vertices]
        own = selection.holds(edges.part, edges.chain, edges.kind, ends.mean(axis=1), selection.bodies(scene))
        if not own.any():
            raise BadValue(f"edges of {name}", "contours only", "feature edges: contours differ from view to view")
        length = np.linalg.norm(ends[own, 1] - ends[own, 0], axis=1)
        middle = (ends[own].mean(axis=1) * length[:, None]).sum(axis=0) / length.sum()
        return cls(name, Kind.EDGE, middle, limits, segments=ends[own])

    @property
    def straight(self) -> bool:
        """Return whether it is one straight edge, along which nothing can be measured."""
        return self.along is not None

    @property
    def along(self) -> Array | None:
        """Return the unit direction (3,) of a straight edge; None for all else."""
        if self.segments is None:
            return None
        d = self.segments[:, 1] - self.segments[:, 0]
        d = d / np.linalg.norm(d, axis=1, keepdims=True)
        same = np.abs(d @ d[0]) > _PARALLEL
        off = self.segments[:, 0] - self.segments[0, 0]
        on_line = np.linalg.norm(off - np.outer(off @ d[0], d[0]), axis=1) <= 1e-6 * np.abs(self.segments).max()
        return np.asarray(d[0]) if (same & on_line).all() else None

    @property
    def ends(self) -> Array:
        """Return the ends (2, 3) of a straight edge; the place twice of all else."""
        along = self.along
        if along is None or self.segments is None:
            return np.stack([self.p, self.p])
        t = ((self.segments - self.p) @ along).ravel()
        return np.asarray(self.p + np.outer([t.min(), t.max()], along))

    def places(self) -> FeaturePlaces:
        """Return where it is looked for and measured."""
        if self.segments is not None:
            return _on_edges(self)
        if self.kind is Kind.CIRCLE:
            assert self.normal is not None
            assert self.diameter_mm is not None
            u, v = plane_axes(self.normal)
            t = 2 * np.pi * np.arange(_RIM) / _RIM
            rim = self.p + self.diameter_mm / 2 * (np.cos(t)[:, None] * u + np.sin(t)[:, None] * v)
            return FeaturePlaces(
                np.concatenate([rim, self.p[None]]), np.arange(_RIM + 1) < _RIM, np.arange(_RIM + 1) == _RIM
            )
        one = np.ones(1, bool)
        return FeaturePlaces(self.p[None], one, one)


@dataclass(slots=True, eq=False)
class FeaturePlaces:
    """p (n, 3); which have to be seen, which are measured; of edges unit tangent, length and place along them, mm."""

    p: Array
    sighted: Mask
    measured: Mask
    tangent: Array | None = None
    length: Array | None = None


def plane_axes(normal: Array) -> tuple[Array, Array]:
    """Return two unit vectors (3,) across a normal (3,)."""
    axis = np.eye(3)[np.argmin(np.abs(normal))]
    u = np.cross(normal, axis)
    u = u / np.linalg.norm(u)
    return u, np.cross(normal, u)


def _on_edges(feature: LayoutFeature) -> FeaturePlaces:
    """Return stations along the segments, as many on each as its share of the length."""
    assert feature.segments is not None
    a, d = feature.segments[:, 0], feature.segments[:, 1] - feature.segments[:, 0]
    length = np.linalg.norm(d, axis=1)
    most = _STATIONS if len(a) == 1 else _MOST_STATIONS
    total = np.cumsum(length)
    at = (np.arange(most) + 0.5) / most * total[-1]
    segment = np.searchsorted(total, at, side="right").clip(max=len(a) - 1)
    fraction = (at - (total - length)[segment]) / length[segment]
    p = a[segment] + fraction[:, None] * d[segment]
    every = np.ones(most, bool)
    return FeaturePlaces(p, every, every, d[segment] / length[segment, None], np.full(most, total[-1] / most))


@dataclass(frozen=True, slots=True, eq=False)
class Places:
    """The places of F features in one list: p (S, 3) mm, whose (S,), sighted and measured (S,), tangents and lengths.

    tangent (S, 3) is NaN, length and from_middle (S,) mm are 0 but on edges. centre, normal (F, 3; NaN for none), axes
    (F, 3, 2) across it, diameter (F,; NaN), ends (F, 2, 3) of straight edges (of all else the centre twice).
    """

    p: Array
    feature: Longs
    sighted: Mask
    measured: Mask
    tangent: Array
    length: Array
    from_middle: Array
    centre: Array
    normal: Array
    axes: Array
    diameter: Array
    ends: Array
    is_straight: Mask
    is_edge: Mask
    is_circle: Mask

    @classmethod
    def facing(cls, p: Array, normal: Array) -> Places:
        """Return those of point features p (F, 3), seen from where their normals (F, 3) point."""
        n = len(p)
        every, never = np.ones(n, bool), np.zeros(n, bool)
        zero, unknown = np.zeros(n), np.full(n, np.nan)
        axis = np.eye(3)[np.argmin(np.abs(normal), axis=1)]
        u = np.cross(normal, axis)
        u = u / np.maximum(np.linalg.norm(u, axis=1, keepdims=True), 1e-300)
        axes = np.stack([u, np.cross(normal, u)], axis=2)
        return cls(
            p, np.arange(n), every, every, np.full((n, 3), np.nan), zero, zero, p, normal, axes, unknown,
            np.stack([p, p], axis=1), never, never, never,
        )  # fmt: skip

    @classmethod
    def of(cls, features: Sequence[LayoutFeature]) -> Places:
        """Return those of some features."""
        each = [f.places() for f in features]
        counts = [len(e.p) for e in each]
        tangent = [
            np.full((n, 3), np.nan) if e.tangent is None else e.tangent for e, n in zip(each, counts, strict=True)
        ]
        length = [np.zeros(n) if e.length is None else e.length for e, n in zip(each, counts, strict=True)]
        p = np.concatenate([e.p for e in each])
        owner = np.repeat(np.arange(len(features)), counts)
        centre = np.array([f.p for f in features])
        along = np.nan_to_num(np.concatenate(tangent))
        none = np.zeros((3, 2))
        axes = [none if f.normal is None else np.stack(plane_axes(f.normal), axis=1) for f in features]
        return cls(
            p,
            owner,
            np.concatenate([e.sighted for e in each]),
            np.concatenate([e.measured for e in each]),
            np.concatenate(tangent),
            np.concatenate(length),
            np.einsum("ij,ij->i", p - centre[owner], along),
            centre,
            np.array([np.full(3, np.nan) if f.normal is None else f.normal for f in features]),
            np.array(axes),
            np.array([np.nan if f.diameter_mm is None else f.diameter_mm for f in features]),
            np.array([f.ends for f in features]),
            np.array([f.straight for f in features]),
            np.array([f.kind is Kind.EDGE for f in features]),
            np.array([f.kind is Kind.CIRCLE for f in features]),
        )
