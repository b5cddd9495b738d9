"""What may hide features from cameras: the part itself, in its own frame, and obstacles, in the world."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Array, Mask
from cadcam.cad.mesh import Mesh
from cadcam.geometry.rigid import Rigid
from cadcam.render.caster import Caster
from cadcam.render.lines.occlusion import OccludingFaces

_TOLERANCE = 1e-4  # of the part's diagonal: tolerance for features given slightly off their face
_DIRECTIONS = 48
_INSIDE = 0.75  # share of rays that hit faces from behind, from inside of a body


class Surroundings:
    """The part and the obstacles; built once for all cameras and poses."""

    def __init__(self, part: Mesh, obstacles: Mesh | None) -> None:
        self._part = _Body(part)
        self._obstacles = None if obstacles is None or not obstacles.n_faces else _Body(obstacles)
        self.tolerance_mm: float = _TOLERANCE * float(np.linalg.norm(part.size_mm))

    def hidden(self, R: Array, t: Array, eye: Array, pose: npt.NDArray[np.int64], p: Array) -> Mask:
        """Return which part points p (n, 3) are hidden in poses (n,), indices of world_from_part R (P, 3, 3), t (P, 3).

        eye (P, 3): the camera in the part frame of each pose. The face that a point lies on never hides it.
        """
        if not len(p):
            return np.zeros(0, bool)
        tolerance = np.full(len(p), self.tolerance_mm)
        hidden = self._part.occluders.hidden(p, eye[pose], tolerance)
        left = np.flatnonzero(~hidden)
        which = pose[left]
        in_world = np.einsum("nij,nj->ni", R[which], p[left]) + t[which]
        hidden[left] = self.behind_obstacles(np.einsum("nij,nj->ni", R[which], eye[which]) + t[which], in_world)
        return hidden

    def behind_obstacles(self, eye: Array, p: Array) -> Mask:
        """Return which points p (n, 3) in the world obstacles hide from cameras at `eye` (n, 3)."""
        if self._obstacles is None or not len(p):
            return np.zeros(len(p), bool)
        return self._obstacles.occluders.hidden(p, eye, np.full(len(p), self.tolerance_mm))

    def holds(self, eye: Array, poses: dict[str, Rigid]) -> str:
        """Return what contains a camera at `eye` (3,) in the world: "an obstacle", "the part in pose ...", or ""."""
        if self._obstacles is not None and self._obstacles.holds(eye):
            return "an obstacle"
        for name, world_from_part in poses.items():
            if self._part.holds(world_from_part.inv @ eye):
                return f"the part in pose {name!r}" if len(poses) > 1 else "the part"
        return ""


class _Body:
    def __init__(self, mesh: Mesh) -> None:
        self.caster = Caster(mesh)
        self.occluders = OccludingFaces(mesh, self.caster)
        self._low, self._high = mesh.bounds

    def holds(self, eye: Array) -> bool:
        """Return whether nearly all rays from `eye` hit faces from behind."""
        if (eye < self._low).any() or (eye > self._high).any():
            return False
        i = np.arange(_DIRECTIONS) + 0.5  # a Fibonacci sphere
        z, turn = 1 - 2 * i / _DIRECTIONS, np.pi * (1 + 5**0.5) * i
        r = np.sqrt(1 - z**2)
        d = np.column_stack([r * np.cos(turn), r * np.sin(turn), z])
        met = self.caster.first_hit(np.tile(eye, (_DIRECTIONS, 1)), d, np.full(_DIRECTIONS, 4 * self.caster.radius))
        behind = (met >= 0) & (np.einsum("ij,ij->i", self.occluders.normals[met], d) > 0)
        return bool(behind.mean() >= _INSIDE)
