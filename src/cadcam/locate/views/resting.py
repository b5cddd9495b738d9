"""The faces on which a part can rest on a plane: where its centre of mass lies above a facet of its convex hull."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cadcam.arrays import Array, Brief, Floats, Longs, Mask, frozen
from cadcam.cad.mesh import Mesh, used_vertices
from cadcam.errors import BadValue
from cadcam.geometry.plane import Plane
from cadcam.kinds import expect, expect_number

_CLOSED = 1e-6  # of the area: a closed surface's vector area is less
_INSIDE = 1e-6  # of a facet: its border counts as inside
_ON = 1e-3  # radii: corners that are so far off a face are its own
_UNSTATED_MM = 1.0  # how well a plane is known if that is not stated
_ONE_DEG = 1.0  # directions closer than this are one face
_MOST = 2048  # faces; of finer round bodies neighbours are left out


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class OnPlane(Brief):
    """A plane of the world that a part lies on: a table, a belt, a tray, on the side where the cameras are.

    down (3,): direction of the part, in its frame, that points to the plane; by default it may lie on any of the faces
    on which it stays lying. within_mm: how far off the plane its face is at most, practically always: by errors of the
    plane, of the cameras' places, and of how the part lies. Where it is stated, found poses are made more accurate by
    the plane, too; else it serves to search and to check, to 1 mm. stated: the plane in the words of who gave it, for
    errors; default its normal and offset.
    """

    plane: Plane
    down: Array | None = None
    within_mm: float | None = None
    stated: str = ""

    def __post_init__(self) -> None:
        expect(self.plane, "plane that the part lies on", Plane)
        if not self.plane.single:
            raise BadValue("plane that the part lies on", f"{len(np.atleast_1d(self.plane.offset))} planes", "one")
        if self.down is not None:
            down = frozen(self.down, "down of the part", (3,))
            if not np.linalg.norm(down) > 0:
                raise BadValue("down of the part", down.tolist(), "a direction, not zero")
            object.__setattr__(self, "down", frozen(down / np.linalg.norm(down), "down of the part", (3,)))
        if self.within_mm is None:
            return
        expect_number(self.within_mm, "within_mm of the plane")
        if not 0 <= self.within_mm < np.inf:
            raise BadValue("within_mm of the plane", self.within_mm, "mm, at least 0")

    @property
    def named(self) -> str:
        """Return the plane as it is named in errors."""
        normal = np.round(self.plane.normal, 6).tolist()
        return self.stated or f"normal {normal}, offset {float(self.plane.offset):.6g} mm"

    @property
    def checked_mm(self) -> float:
        """Return to how many mm poses are checked."""
        return _UNSTATED_MM if self.within_mm is None else self.within_mm


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class RestingFaces(Brief):
    """Faces that a part may lie on: unit directions down (F, 3) out of it, and whether it stays lying there (F,).

    height (F,): of the part's frame's origin above the plane, mm. corners: those (n, 3) of each face, mm, part frame.
    """

    down: Array
    height: Array
    stable: Mask
    corners: tuple[Array, ...]

    @classmethod
    def of(cls, mesh: Mesh) -> RestingFaces:
        """Return those of a mesh, the widest first."""
        from scipy.spatial import ConvexHull, QhullError

        points = mesh.vertices[used_vertices(mesh)]
        try:
            hull = ConvexHull(points)
        except QhullError:  # flat
            hull = ConvexHull(points, qhull_options="QJ")
        normal = hull.equations[:, :3]
        stable = _below(centre_of_mass(mesh), points[hull.simplices], normal)
        order = np.lexsort((-_areas(points[hull.simplices]), ~stable))
        kept = few(normal[order], _MOST)
        down, stable = normal[order][kept], stable[order][kept]
        vertices, near = points[hull.vertices], _ON * float(np.linalg.norm(mesh.size_mm)) / 2
        height, corners = np.zeros(len(down)), list[Array]()
        for k, direction in enumerate(down):  # all at once they would not fit into memory
            reach = vertices @ direction
            height[k] = reach.max()
            corners.append(vertices[reach >= height[k] - near])
        return cls(down, height, stable, tuple(corners))

    def chosen(self, down: Floats | None, within_deg: float) -> Longs:
        """Return the numbers of those on which the part stays lying, or of all near a unit direction (3,) down."""
        if down is None:
            return np.flatnonzero(self.stable)
        near = np.flatnonzero(self.down @ np.asarray(down) >= np.cos(np.radians(within_deg)))
        if not len(near):
            few = ", ".join(f"({x:.3g}, {y:.3g}, {z:.3g})" for x, y, z in self.down[self.stable][:6] + 0.0)
            said = f"{np.asarray(down).tolist()}, where it has no face within {within_deg:g} deg"
            raise BadValue("down of the part", said, f"out of a face of its convex hull; it stays lying on {few}")
        return near


def few(directions: Array, most: int) -> Longs:
    """Return the numbers of at most so many of unit directions (N, 3), a degree from every earlier one, or 2, 4 ..."""
    step = _ONE_DEG
    while len(kept := _apart(directions, step, most + 1)) > most:
        step *= 2
    return kept


def _apart(directions: Array, least_deg: float, most: int) -> Longs:
    """Return the numbers of the first directions that are so many degrees from every earlier one that is kept."""
    kept: list[int] = []
    left = np.ones(len(directions), bool)
    while len(kept) < most and left.any():
        kept.append(int(np.argmax(left)))
        left &= directions @ directions[kept[-1]] < np.cos(np.radians(least_deg))
        left[kept[-1]] = False
    return np.array(kept, np.int64)


def centre_of_mass(mesh: Mesh) -> Array:
    """Return the centre (3,) mm of the volume of a closed mesh, of the surface of another."""
    T = mesh.vertices[mesh.faces]
    middle = mesh.bounds.mean(axis=0)
    across = np.cross(T[:, 1] - T[:, 0], T[:, 2] - T[:, 0])
    area = np.linalg.norm(across, axis=1)
    volume = np.einsum("fi,fi->f", T[:, 0] - middle, across)
    thick = volume.sum() > _CLOSED * area.sum() * float(np.linalg.norm(mesh.size_mm))
    if thick and np.linalg.norm(across.sum(axis=0)) < _CLOSED * area.sum():
        return np.asarray(middle + volume @ (T - middle).sum(axis=1) / (4 * volume.sum()))
    return np.asarray(area @ T.mean(axis=1) / area.sum())


def _areas(facets: Array) -> Array:
    return np.asarray(np.linalg.norm(np.cross(facets[:, 1] - facets[:, 0], facets[:, 2] - facets[:, 0]), axis=1))


def _below(centre: Array, facets: Array, normal: Array) -> Mask:
    """Return which facets (F, 3, 3), triangles with normals (F, 3), have a point (3,) above them along the normal."""
    inside = np.ones(len(facets), bool)
    for k in range(3):
        a, b, c = (facets[:, (k + j) % 3] for j in range(3))
        side = np.einsum("fi,fi->f", np.cross(b - a, normal), c - a)
        here = np.einsum("fi,fi->f", np.cross(b - a, normal), centre - a)
        inside &= here * np.sign(side) >= -_INSIDE * np.abs(side)
    return inside
