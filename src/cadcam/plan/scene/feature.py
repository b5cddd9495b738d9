"""What has to be measured: points, marks and holes, edges of the part, each with the limits of a tolerance file."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np

from cadcam.arrays import Array, Brief, frozen
from cadcam.errors import BadValue
from cadcam.kinds import expect_each, expect_numbers, expect_positive
from cadcam.render.view import Scene
from cadcam.verify.tolerances.tolerance import Limit, Quantity, Selection

_PARALLEL = 1 - 1e-6


class Kind(Enum):
    """How a feature is measured in a picture: as a point; by its outline; across itself."""

    POINT = "point"
    CIRCLE = "circle"
    EDGE = "edge"


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class LayoutFeature(Brief):
    """A feature in the part frame, mm, and what is asked of it.

    p (3,): the point, the circle's centre or the middle of the edges. normal (3,): unit vector out of the surface, from
    whose side alone it is seen; None: any side. segments (S, 2, 3): straight pieces of edges. plane_mm: standard
    deviation of the height of the known plane that it lies on; None: there is none, and two cameras are needed.
    selection: by which edges of the part were chosen.
    """

    name: str
    kind: Kind
    p: Array
    limits: tuple[Limit, ...]
    normal: Array | None = None
    diameter_mm: float | None = None
    segments: Array | None = None
    plane_mm: float | None = None
    selection: Selection | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "p", frozen(self.p, f"place of {self.name}", (3,)))
        if self.normal is not None:
            n = frozen(self.normal, f"normal of {self.name}", (3,))
            if not np.linalg.norm(n) > 0:
                raise BadValue(f"normal of {self.name}", n.tolist(), "a vector that is not zero")
            object.__setattr__(self, "normal", frozen(n / np.linalg.norm(n), "normal", (3,)))
        if self.segments is not None:
            object.__setattr__(self, "segments", frozen(self.segments, f"segments of {self.name}", (None, 2, 3)))
        object.__setattr__(self, "limits", expect_each(self.limits, f"limits of {self.name}", Limit))
        expect_numbers(self)
        if self.diameter_mm is not None:
            expect_positive(self.diameter_mm, f"diameter of {self.name}", "a positive number of mm")
        if self.kind is Kind.CIRCLE and (self.normal is None or self.diameter_mm is None):
            raise BadValue(f"circle {self.name}", "without normal or diameter_mm", "both")
        if self.kind is not Kind.CIRCLE and self.diameter_mm is not None:
            raise BadValue(f"diameter of {self.name}", f"{self.diameter_mm:g} mm of no circle", "none, or a circle")
        if self.plane_mm is not None and not (self.normal is not None and self.plane_mm > 0):
            raise BadValue(f"known plane of {self.name}", "without a normal, or not above 0 mm", "both")
        for limit in self.limits:
            if limit.quantity not in (Quantity.POSITION, Quantity.ANGLE):
                raise BadValue(f"limit of {self.name}", limit.quantity.value, "position_mm or angle_deg")
            if limit.quantity is Quantity.ANGLE and not self.straight:
                raise BadValue(f"angle_deg of {self.name}", "asked of what has no direction", "an edge_mm to ask it of")
            if limit.direction is not None and self.along is not None and abs(limit.direction @ self.along) > _PARALLEL:
                raise BadValue(f"direction of {self.name}", "along the edge", "one across it: along it nothing shows")

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
        own, ends = selection.segments(scene)
        if not own.any():
            raise BadValue(f"edges of {name}", "contours only", "feature edges: contours differ from view to view")
        length = np.linalg.norm(ends[own, 1] - ends[own, 0], axis=1)
        middle = (ends[own].mean(axis=1) * length[:, None]).sum(axis=0) / length.sum()
        return cls(name, Kind.EDGE, middle, limits, segments=ends[own], selection=selection)

    @property
    def straight(self) -> bool:
        """Return whether it is a single straight edge, along which nothing can be measured."""
        return self.along is not None

    @property
    def along(self) -> Array | None:
        """Return the unit direction (3,) of a straight edge; None for other features."""
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
        """Return the ends (2, 3) of a straight edge; for other features their place, twice."""
        along = self.along
        if along is None or self.segments is None:
            return np.stack([self.p, self.p])
        t = ((self.segments - self.p) @ along).ravel()
        return np.asarray(self.p + np.outer([t.min(), t.max()], along))
