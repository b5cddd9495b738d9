"""Screws of rigid motions, and what motions with common screws leave undetermined.

A motion turns by an angle about an axis and slides along it. Both numbers stay when the motion is seen from another
frame, A = X B X^-1 (Chen, CVPR 1991): they test whether two lists of motions can belong together before X is known. The
rotation angle of a motion between two poses even stays when all poses are inverted; the slide does not.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cadcam.arrays import Array
from cadcam.geometry import rotation as so3
from cadcam.geometry.rigid import Rigid


def angles_and_slides(T: Rigid) -> tuple[Array, Array]:
    """Return rotation angles (m,) in [0, pi] rad and translations along the axes (m,) mm of motions.

    The slide's sign follows the axis, which has none at an angle of 0 or pi: it is 0 where there is no rotation.
    """
    w = so3.log(T.rotation)
    angle = np.linalg.norm(w, axis=-1)
    axis = w / np.where(angle > 1e-12, angle, np.inf)[..., None]
    return angle, np.sum(axis * T.translation, axis=-1)


@dataclass(frozen=True, slots=True, eq=False)
class Response:
    """How strongly a set of motions answers a change of what they carry: six twists and the answer to each.

    twists (6, 6): one (translation mm, rotation rad) a row, from the least seen to the best; strength (6,): rms change
    of the carried thing's observed motion for a unit change of `length` mm or 1 rad, dimensionless. A strength of 0 is
    a change that no observation can show.
    """

    twists: Array
    strength: Array
    length: float


def response(A: Rigid, length: float) -> Response:
    """Return how motions A (m) answer to X <- exp(xi) X in A X = X B: through (Ad(A) - I) xi.

    xi is unseen if and only if exp(xi) commutes with every A: a slide along an axis that all rotations share, a turn
    about it where they share the very line, every slide where nothing turns.
    """
    scale = np.repeat([length, 1.0], 3)
    M = (A.adjoint() - np.eye(6)) * scale / scale[:, None]
    eigenvalues, vectors = np.linalg.eigh(np.einsum("kij,kil->jl", M, M) / len(M))
    return Response(vectors.T * scale, np.sqrt(np.maximum(eigenvalues, 0)), length)


def slides_and_turns(twists: Array, length: float) -> tuple[Array, Array]:
    """Return a basis of a space of twists (k, 6) as pure slides (s, 3) of unit length, and the other twists (k - s, 6).

    The others have a unit rotation and stand in right angles to the slides, mm and rad.
    """
    scaled = twists / np.repeat([length, 1.0], 3)
    U, s, _ = np.linalg.svd(scaled[:, 3:], full_matrices=True)
    turning = np.zeros(len(twists), dtype=bool)
    turning[: len(s)] = s > 1e-3
    mixed = U.T @ scaled
    slides = mixed[~turning, :3]
    slides = slides / np.linalg.norm(slides, axis=1, keepdims=True)
    turns = mixed[turning]
    turns[:, :3] -= turns[:, :3] @ slides.T @ slides
    turns = turns / np.linalg.norm(turns[:, 3:], axis=1, keepdims=True)
    return slides, turns * np.repeat([length, 1.0], 3)


def line_of(twist: Array) -> tuple[Array, Array]:
    """Return the point (3,) mm nearest to the origin and the unit direction (3,) of the axis a twist turns about."""
    v, w = twist[:3], twist[3:]
    size = float(np.linalg.norm(w))
    return np.cross(w, v) / size**2, w / size
