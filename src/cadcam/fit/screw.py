"""Screws of rigid motions, and what motions with common screws leave undetermined.

A motion rotates by an angle about an axis and slides along it. Both numbers are the same in every frame, A = X B X^-1
(Chen, CVPR 1991): they test whether two lists of motions can belong together before X is known. Both are also the same
when all poses are inverted, which maps each motion to one like its inverse: a wrong direction shows in the relative
directions of the axes of different motions, not in any pair of poses.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cadcam.arrays import Array
from cadcam.geometry import rotation as so3
from cadcam.geometry.rigid import Rigid

_TURNS = 0.05  # a twist about a line farther off than the inverse of this, in lengths, counts as a slide


def angles_and_slides(T: Rigid) -> tuple[Array, Array]:
    """Return rotation angles (m,) in [0, pi] rad and translations along the axes (m,) mm of motions.

    The slide's sign follows the axis, which has none at an angle of 0 or pi: it is 0 where there is no rotation.
    """
    w = so3.log(T.rotation)
    angle = np.linalg.norm(w, axis=-1)
    axis = w / np.where(angle > 1e-12, angle, np.inf)[..., None]
    return angle, np.sum(axis * T.translation, axis=-1)


@dataclass(frozen=True, slots=True, eq=False)
class Undetermined:
    """What motions leave undetermined about the pose of what they carry.

    slides (s, 3): orthonormal directions along which it may move; turns (k, 6): other twists, translation mm and
    rotation of unit length, perpendicular to the slides. strength: the largest response among them, 0 if exact.
    """

    slides: Array
    turns: Array
    strength: float

    @property
    def any(self) -> bool:
        """Return whether anything is undetermined."""
        return bool(len(self.slides) + len(self.turns))


def freedom(A: Rigid, *, length: float, floor: float) -> Undetermined:
    """Return the changes X <- exp(xi) X to which motions A (m) respond by less than `floor` in A X = X B.

    The response is (Ad(A) - I) xi, rms over the motions, for a unit change of `length` mm or 1 rad: dimensionless. It
    is zero if and only if exp(xi) commutes with every A: a slide along an axis that all rotations share, a rotation
    about it where they share the same line, every slide where nothing rotates. Slides are examined first and
    separately: noise would mix them with rotations about distant lines.
    """
    scale = np.repeat([length, 1.0], 3)
    M = (A.adjoint() - np.eye(6)) * scale / scale[:, None]
    G = np.einsum("kij,kil->jl", M, M) / len(M)
    along, V = np.linalg.eigh(G[:3, :3])
    blind = along < floor**2
    rest = np.zeros((6, 6 - np.count_nonzero(blind)))
    rest[:3, : np.count_nonzero(~blind)] = V[:, ~blind]
    rest[3:, np.count_nonzero(~blind) :] = np.eye(3)
    others, W = np.linalg.eigh(rest.T @ G @ rest)
    open_ = others < floor**2
    turns = (rest @ W[:, open_]).T
    turning = np.linalg.norm(turns[:, 3:], axis=1) > _TURNS
    slides = np.concatenate([V[:, blind].T, _unit(turns[~turning, :3])])
    turns = turns[turning] * scale / np.linalg.norm(turns[turning, 3:], axis=1, keepdims=True)
    strongest = max(float(along[blind].max(initial=0.0)), float(others[open_].max(initial=0.0)))
    return Undetermined(slides, turns, float(np.sqrt(max(strongest, 0.0))))


def _unit(v: Array) -> Array:
    return np.asarray(v / np.linalg.norm(v, axis=-1, keepdims=True))


def line_of(twist: Array) -> tuple[Array, Array]:
    """Return the point (3,) mm nearest to the origin and the unit direction (3,) of the axis of a twist."""
    v, w = twist[:3], twist[3:]
    size = float(np.linalg.norm(w))
    return np.cross(w, v) / size**2, w / size
