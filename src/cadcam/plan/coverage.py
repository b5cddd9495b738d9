"""Coverage: how many cameras see each piece of the part's surface, painted on it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Array
from cadcam.cad.edges import FeatureEdges
from cadcam.cad.mesh import Mesh
from cadcam.plan.candidate import Candidate
from cadcam.plan.layout import Layout
from cadcam.render.view import Scene

Longs = npt.NDArray[np.int64]
_PIECE = 1 / 45  # of the part's diagonal: longest side of a piece that is painted
_MOST = 400_000  # pieces
# dark blue to yellow, told apart in grey and by people with any colour vision; grey for what no camera sees
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


@dataclass(frozen=True, slots=True, eq=False)
class Coverage:
    """Pieces of the part's surface (its own frame), and how many cameras see each (F,) in the pose that shows it worst.

    area (F,) mm^2. A piece counts as seen from at most the slant that the scene allows, unhidden and in the picture.
    """

    mesh: Mesh
    cameras: Longs
    area: Array

    @property
    def shares(self) -> Array:
        """Return the share of the surface that is seen by 0, 1, 2 ... cameras."""
        return np.asarray(np.bincount(self.cameras, self.area) / self.area.sum())

    def painted(self) -> Scene:
        """Return the part with each piece in the colour of its count, for a renderer."""
        colors = np.concatenate([np.ones((len(self.mesh.part_names), 3)), COLORS]).astype(np.float32)
        level = np.minimum(self.cameras, len(COLORS) - 1)
        none = np.zeros((0, 2), np.int32)
        edges = FeatureEdges(none, none, none[:, 0], none[:, 0], none[:, 0])  # those of pieces mean nothing
        return Scene(self.mesh, edges, colors, (len(self.mesh.part_names) + level).astype(np.int32))


def coverage(layout: Layout) -> Coverage:
    """Return how the chosen cameras cover the part."""
    mesh = divided(layout.survey.scene.part)
    middle, normal = mesh.vertices[mesh.faces].mean(axis=1), mesh.face_normals
    poses = range(len(layout.survey.poses))
    counts = [np.sum([_seen(layout, c, i, middle, normal) for c in layout.cameras], axis=0) for i in poses]
    return Coverage(mesh, np.min(np.stack(counts), axis=0), mesh.face_areas)


def _seen(layout: Layout, candidate: Candidate, pose: int, p: Array, normal: Array) -> Longs:
    """Return 1 for each place p (n, 3) of the part with this normal that a camera sees, else 0."""
    world_from_part = layout.survey.poses[pose]
    view, seeing = candidate.viewpoint, layout.survey.scene.seeing
    q = view.camera.project(view.camera_from_world @ (world_from_part @ p))
    eye = world_from_part.inv @ candidate.eye
    towards = eye - p
    cosine = np.einsum("ij,ij->i", towards, normal) / np.linalg.norm(towards, axis=1)
    ask = np.flatnonzero(view.camera.sees(q) & (cosine >= np.cos(seeing.incidence)))
    R, t = world_from_part.rotation[None], world_from_part.translation[None]
    hidden = layout.survey.surroundings.hidden(R, t, eye[None], np.zeros(len(ask), np.int64), p[ask])
    out = np.zeros(len(p), np.int64)
    out[ask[~hidden]] = 1
    return out


def divided(mesh: Mesh) -> Mesh:
    """Return the mesh with its large faces cut into pieces, halving their longest sides."""
    limit = _PIECE * float(np.linalg.norm(mesh.size_mm))
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


def legend(most: int) -> Sequence[tuple[str, Array]]:
    """Return what the colours mean, up to a number of cameras."""
    last = len(COLORS) - 1
    words = ["no camera", "one camera", *(f"{n} cameras" for n in range(2, last)), f"{last} or more"]
    return list(zip(words, COLORS, strict=True))[: min(most, last) + 1]
