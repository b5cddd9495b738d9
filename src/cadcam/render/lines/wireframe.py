"""The lines of a view as data: options, polylines that keep their 3D edge, the wireframe."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cadcam.arrays import Array, Brief, Ids, Longs, Mask, frozen
from cadcam.camera.camera import Camera
from cadcam.geometry.rigid import Rigid
from cadcam.kinds import expect_numbers, expect_positive


@dataclass(frozen=True, slots=True)
class LineOptions:
    """The contents of a wireframe.

    `contours`: silhouettes of curved surfaces too. `hidden`: hidden lines too, as their own set. `margin_px`: lines
    extend this far beyond the picture. `chord_px`: largest distance of a line from its exact image curve. `near_mm`:
    distance of the near plane from the focal plane (default 1e-5 of the scene's diagonal). `coincident_mm`: a face
    whose plane misses a point by less does not hide it (default 1e-6 of the diagonal).
    """

    contours: bool = True
    hidden: bool = False
    margin_px: float = 8.0
    chord_px: float = 0.02
    near_mm: float | None = None
    coincident_mm: float | None = None

    def __post_init__(self) -> None:
        expect_numbers(self)
        expect_positive(self.chord_px, "chord_px", "a positive number of px")
        expect_positive(self.margin_px, "margin_px", "a number of px, at least 0", zero=True)
        for name in ("near_mm", "coincident_mm"):
            if getattr(self, name) is not None:
                expect_positive(getattr(self, name), name, "a length in mm, at least 0, or None", zero=True)


PLAIN_LINES = LineOptions()


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Polylines(Brief):
    """M polylines, each point in the picture and in space.

    `q` (N, 2) distorted px and `p` (N, 3) mm in the world frame: q is the exact image of p. `segment` (N,) is the
    scene's feature segment that leads away from a point (at a last point, that led to it), -1 on contours. Polyline m
    holds points start[m] to start[m + 1] - 1; `kind` (EdgeKind), `part` and `chain` (M,) are its own; chains of
    contours are numbered after the scene's and differ from view to view.
    """

    q: Array
    p: Array
    segment: Ids
    start: Ids
    kind: Ids
    part: Ids
    chain: Ids

    def __post_init__(self) -> None:
        for name, shape in (("q", (None, 2)), ("p", (None, 3))):
            object.__setattr__(self, name, frozen(getattr(self, name), f"polyline {name}", shape))
        for name in ("segment", "start", "kind", "part", "chain"):
            object.__setattr__(self, name, frozen(getattr(self, name), f"polyline {name}", (None,), np.int32))

    def __len__(self) -> int:
        return len(self.kind)

    @property
    def lines(self) -> list[Array]:
        """Return the pixels (n, 2) of each polyline."""
        return [self.q[i:j] for i, j in zip(self.start[:-1], self.start[1:], strict=True)]

    @property
    def line_of_point(self) -> Longs:
        """Return the polyline (N,) that each point belongs to."""
        return np.repeat(np.arange(len(self)), np.diff(self.start))

    @property
    def length_px(self) -> Array:
        """Return the length (M,) of each polyline in px."""
        line, steps = self.line_of_point, np.linalg.norm(np.diff(self.q, axis=0), axis=1)
        same = line[1:] == line[:-1]
        return np.asarray(np.bincount(line[1:][same], steps[same], minlength=len(self)), np.float64)

    def select(self, lines: Mask) -> Polylines:
        """Return the chosen polylines (mask over M)."""
        points = lines[self.line_of_point]
        start = np.concatenate([[0], np.cumsum(np.diff(self.start)[lines])])
        return Polylines(
            self.q[points],
            self.p[points],
            self.segment[points],
            start,
            self.kind[lines],
            self.part[lines],
            self.chain[lines],
        )

    def points_along(self, step_px: float) -> tuple[Array, Array, Longs, Array]:
        """Return points up to `step_px` apart: q (n, 2) px, unit normals (n, 2), each one's polyline (n,), length (n,).

        The length (px) is what a point stands for: segments that are shorter than the step have one each.
        """
        line = self.line_of_point
        first = np.flatnonzero(line[1:] == line[:-1])
        d = self.q[first + 1] - self.q[first]
        length = np.hypot(d[:, 0], d[:, 1])
        n = np.maximum(np.ceil(length / step_px), 1).astype(np.int64)
        index = np.repeat(np.arange(len(first)), n)
        fraction = (np.arange(len(index)) - np.repeat(np.cumsum(n) - n, n) + 0.5) / n[index]
        q = self.q[first[index]] + fraction[:, None] * d[index]
        normal = np.stack([-d[:, 1], d[:, 0]], axis=1) / np.maximum(length, 1e-300)[:, None]
        return q, normal[index], line[first[index]], (length / n)[index]


_NONE = np.zeros(0, np.int32)
NO_LINES = Polylines(np.zeros((0, 2)), np.zeros((0, 3)), _NONE, np.zeros(1, np.int32), _NONE, _NONE, _NONE)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Wireframe:
    """The lines of a scene as `camera` sees them from `camera_from_world`; `hidden` is empty unless requested."""

    camera: Camera
    camera_from_world: Rigid
    visible: Polylines
    hidden: Polylines

    @property
    def empty(self) -> bool:
        """Return whether no visible line runs through the picture."""
        return not self.camera.sees(self.visible.q).any() and not _crosses_picture(self)

    def __repr__(self) -> str:
        size = f"{self.camera.width} x {self.camera.height} px"
        return f"Wireframe({size}: {len(self.visible)} visible lines, {len(self.hidden)} hidden)"


def _crosses_picture(wireframe: Wireframe) -> bool:
    """Return whether a segment runs through the picture, however long: clipped to it (Liang and Barsky 1984)."""
    line, q = wireframe.visible.line_of_point, wireframe.visible.q
    first = np.flatnonzero(line[1:] == line[:-1])
    d = q[first + 1] - q[first]
    with np.errstate(divide="ignore", invalid="ignore"):  # along an axis: from -inf to inf, or nowhere
        low, high = (-0.5 - q[first]) / d, (np.array(wireframe.camera.size) - 0.5 - q[first]) / d
    enters, leaves = np.fmin(low, high).max(axis=1), np.fmax(low, high).min(axis=1)
    return bool((np.maximum(enters, 0.0) <= np.minimum(leaves, 1.0)).any())
