"""Coverage: how many cameras see each piece of the part's surface, and how well a point on it would be measured.

A piece is treated as a point feature at its centre with the surface's normal: seen, found and measured by the same
rules, so that the picture shows for the whole surface what the tables say of the features.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from statistics import mode
from typing import TypeVar

import numpy as np
from scipy.spatial import cKDTree

from cadcam.arrays import Array, Brief, Longs, Mask
from cadcam.cad.edges import NO_EDGES
from cadcam.cad.mesh import Mesh
from cadcam.geometry.rigid import Rigid
from cadcam.plan.assessment.asked import Asked
from cadcam.plan.assessment.assess import assess
from cadcam.plan.layout import Layout, Step, nothing
from cadcam.plan.sight.places import Places
from cadcam.plan.sight.visibility import seen_from, sees
from cadcam.plan.uncertainty.finding import Finder
from cadcam.render.view import Scene

_Told = TypeVar("_Told")  # by a camera

_PIECE = 1 / 45  # longest side of a painted piece, as a share of the part's diagonal
_MOST = 400_000  # most pieces
_AT_ONCE = 20_000
# dark blue to yellow, distinct in grey and with any colour vision; grey for what no camera sees
COLORS = np.array(
    [
        [0.55, 0.55, 0.55],
        [0.75, 0.20, 0.25],
        [0.20, 0.35, 0.70],
        [0.10, 0.60, 0.60],
        [0.45, 0.78, 0.40],
        [0.98, 0.90, 0.30],
    ]
)
_STEPS = np.outer(10.0 ** np.arange(-4, 4), [1.0, 2.0, 5.0]).ravel()  # mm, boundaries between the colours of U


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Painting(Brief):
    """A colour for each piece of the part: level (F,) is its index in colors (C, 3); words (C): their meaning."""

    title: str
    mesh: Mesh
    level: Longs
    colors: Array
    words: tuple[str, ...]

    @property
    def shares(self) -> Array:
        """Return the share of the surface (C,) in each colour."""
        area = self.mesh.face_areas
        return np.asarray(np.bincount(self.level, area, minlength=len(self.colors)) / area.sum())

    def scene(self) -> Scene:
        """Return the part in these colours, for a renderer."""
        parts = len(self.mesh.part_names)
        colors = np.concatenate([np.ones((parts, 3)), self.colors]).astype(np.float32)
        return Scene(self.mesh, NO_EDGES, colors, (parts + self.level).astype(np.int32))


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class SurfaceCoverage(Brief):
    """Pieces of the part's surface (its own frame), each in the pose in which it is seen or measured worst.

    cameras (F,): how many see it. U (F,) mm: k sigma of a point there in its worst direction; NaN where it cannot be
    measured in every pose, or where no sigma_px of such a point is stated. k: coverage factor.
    """

    mesh: Mesh
    cameras: Longs
    U: Array
    k: float

    @property
    def shares(self) -> Array:
        """Return the share of the surface that is seen by 0, 1, 2 ... cameras."""
        return np.asarray(np.bincount(self.cameras, self.mesh.face_areas) / self.mesh.face_areas.sum())

    def counted(self, most: int) -> Painting:
        """Return the part painted by the number of cameras, up to `most`, and at the most five."""
        last = min(most, len(COLORS) - 1)
        words = ("no camera", "one camera", *(f"{n} cameras" for n in range(2, last + 1)))[: last + 1]
        if most > last:
            words = (*words[:-1], f"{last} or more")
        return Painting("seen by", self.mesh, np.minimum(self.cameras, last), COLORS[: last + 1], words)

    def measured(self) -> Painting | None:
        """Return the part painted by U, five steps of 1, 2 and 5 about its median by area; None if all is unknown."""
        known = np.isfinite(self.U)
        if not known.any():
            return None
        order = np.argsort(self.U[known])
        area = np.cumsum(self.mesh.face_areas[known][order])
        middle = self.U[known][order][np.searchsorted(area, area[-1] / 2)]
        first = int(np.clip(np.searchsorted(_STEPS, middle) - 1, 0, len(_STEPS) - 4))
        ends = _STEPS[first : first + 4]
        level = np.where(known, 1 + np.searchsorted(ends, self.U), 0)  # 0: not measured
        words = ("not measured", *(f"U up to {e:g} mm" for e in ends), f"U above {ends[-1]:g} mm")
        colors = np.concatenate([COLORS[:1], COLORS[:0:-1]])  # the less uncertain, the brighter
        return Painting(f"U = {self.k:g} sigma of a point", self.mesh, level, colors, words)


def coverage(layout: Layout, pieces: Mesh | None = None, *, step: Step = nothing) -> SurfaceCoverage:
    """Return how the chosen cameras cover the part.

    Pieces of similar place and normal that the same cameras see share the U of one of them: it varies slowly.
    pieces: the part already `divided`. step is called `coverage_steps` times on the way.
    """
    mesh = divided(layout.survey.scene.part) if pieces is None else pieces
    middle, normal = mesh.vertices[mesh.faces].mean(axis=1), mesh.face_normals
    size = _PIECE * float(np.linalg.norm(mesh.size_mm))
    where = np.column_stack([np.floor(middle / size), np.rint(2 * normal)]).astype(np.int64)
    judged = layout.survey.scene.finder.sigma_px is not None
    cameras, sigma = np.full(len(middle), len(layout.cameras)), np.full(len(middle), 0.0 if judged else np.nan)
    for pose in layout.survey.poses:
        seen = _seen(layout, pose, middle, normal, step)
        cameras = np.minimum(cameras, seen.sum(axis=0))
        if judged:
            sigma = np.maximum(sigma, _sigma(layout, pose, middle, normal, seen, where))  # NaN stays
    k = mode(limit.k for limit in layout.survey.asked.limits)
    return SurfaceCoverage(mesh, cameras, k * sigma, k)


def coverage_steps(layout: Layout, pieces: Mesh) -> int:
    """Return how often `coverage` calls its step for these pieces."""
    return len(layout.survey.poses) * len(_portions(pieces.n_faces))


def _portions(n: int) -> list[slice]:
    return [slice(first, first + _AT_ONCE) for first in range(0, n, _AT_ONCE)]


def _seen(layout: Layout, pose: Rigid, p: Array, normal: Array, step: Step) -> Mask:
    """Return which camera sees which point (V, n) of the part."""
    out = []
    for i in _portions(len(p)):
        out.append([seen[0] for seen in _by_each_camera(sees, layout, pose, Places.facing(p[i], normal[i]))])
        step()
    return np.concatenate(out, axis=1)


def _sigma(layout: Layout, pose: Rigid, p: Array, normal: Array, seen: Mask, where: Longs) -> Array:
    """Return the worst sigma (n,) mm of points that at least two cameras see, else NaN, computed once per `where`."""
    out, rows = np.full(len(p), np.nan), np.flatnonzero(seen.sum(axis=0) >= 2)
    _, first, of = np.unique(np.column_stack([where, seen.T])[rows], axis=0, return_index=True, return_inverse=True)
    one = rows[first]
    if len(one):
        places, asked = Places.facing(p[one], normal[one]), Asked.of_positions(len(one))
        found = assess(layout.cameras, _by_each_camera(seen_from, layout, pose, places), places, [pose], asked)
        out[rows] = found.sigma[0][of.reshape(-1)]
    return out


def _by_each_camera(look: Callable[..., _Told], layout: Layout, pose: Rigid, places: Places) -> list[_Told]:
    """Return what each chosen camera tells of places of the part, by `sees` or `seen_from`."""
    scene = layout.survey.scene
    finder = scene.finder if scene.finder.sigma_px is not None else Finder(sigma_px=1.0)  # seen is seen by any
    return [
        look(c.viewpoint, c.optics, places, [pose], layout.survey.surroundings, finder=finder, seeing=scene.seeing)
        for c in layout.cameras
    ]


def coarser(painting: Painting, part: Mesh, most: int) -> Painting:
    """Return a painting of a part in about `most` pieces, or as many as the part has faces, each as its middle was."""
    fewer = max(painting.mesh.n_faces / most, 1.0)
    pieces = divided(part, _PIECE * float(np.sqrt(fewer)))
    size = _PIECE * float(np.linalg.norm(part.size_mm))

    def middles(mesh: Mesh) -> Array:
        return np.column_stack([mesh.vertices[mesh.faces].mean(axis=1), size * mesh.face_normals])

    nearest = cKDTree(middles(painting.mesh)).query(middles(pieces))[1]
    return replace(painting, mesh=pieces, level=painting.level[nearest])


def divided(mesh: Mesh, share: float = _PIECE) -> Mesh:
    """Return the mesh with its large faces cut by halving sides longer than this share of its diagonal."""
    limit = share * float(np.linalg.norm(mesh.size_mm))
    corners, of = mesh.vertices[mesh.faces], np.arange(mesh.n_faces)
    done: list[Array] = []
    owners: list[Longs] = []
    while len(corners):
        side = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)
        long = side.max(axis=1) > limit
        if sum(map(len, done)) + 2 * len(corners) > _MOST:
            long[:] = False
        done.append(corners[~long])
        owners.append(of[~long])
        corners, of, first = corners[long], of[long], side[long].argmax(axis=1)
        a, b, c = (corners[np.arange(len(of)), (first + k) % 3] for k in range(3))
        m = (a + b) / 2
        corners = np.concatenate([np.stack([a, m, c], axis=1), np.stack([m, b, c], axis=1)])
        of = np.concatenate([of, of])
    points, face = np.concatenate(done), np.concatenate(owners)
    return Mesh(
        points.reshape(-1, 3),
        np.arange(3 * len(points), dtype=np.int32).reshape(-1, 3),
        mesh.part[face],
        mesh.surface[face],
        mesh.part_names,
        mesh.part_colors,
    )
