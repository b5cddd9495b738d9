"""How a part may move while its pose is refined: freely, in a plane, about an axis, along a direction."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from cadcam.arrays import Array, Floats, Locked, frozen
from cadcam.errors import BadValue
from cadcam.geometry.plane import axes_across
from cadcam.geometry.rigid import Rigid
from cadcam.geometry.rotation import cross, exp, hat

Frame = Literal["world", "part"]

_WITHIN = 1e-9  # of its length: a motion this near to what a freedom spans is one of its own
_SPANNED = 1e-4  # of the part's radius, or rad: one this near to given motions of the part cannot be told from them


@dataclass(frozen=True, slots=True, eq=False)
class Freedom(Locked):
    """The motions that are allowed, from the start pose on: twists (translation mm, rotation rad) spanned by `basis`.

    basis (6, k): columns are twists of the world (the motion acts on the placed part) or of the part's own frame.
    """

    basis: Array = field(default_factory=lambda: np.eye(6))
    frame: Frame = "part"

    def __post_init__(self) -> None:
        basis = frozen(self.basis, "freedom", (6, None))
        if basis.shape[1] == 0 or np.linalg.matrix_rank(basis) < basis.shape[1]:
            raise BadValue("freedom", f"of shape {basis.shape}, dependent columns", "1 to 6 independent twists")
        if self.frame not in ("world", "part"):
            raise BadValue("frame of the freedom", self.frame, "'world' or 'part'")
        object.__setattr__(self, "basis", basis)

    def __repr__(self) -> str:
        """Return a short description of the motions, for signatures."""
        k = self.basis.shape[1]
        return "Freedom()" if self.frame == "part" and k == 6 else f"Freedom({k} of 6 twists, frame={self.frame!r})"

    @property
    def full(self) -> bool:
        """Return whether nothing is restricted: all six motions are allowed."""
        return bool(self.basis.shape[1] == 6)

    @classmethod
    def planar(cls, normal: Floats, *, frame: Frame = "world") -> Freedom:
        """Return two translations across `normal` (3,) and the rotation about it: a part that lies on a floor."""
        n = _unit(normal, "normal of the plane")
        one, other = axes_across(n)
        zero = np.zeros(3)
        columns = [np.r_[one, zero], np.r_[other, zero], np.r_[zero, n]]
        return cls(np.stack(columns, axis=1), frame)

    @classmethod
    def about(cls, point: Floats, direction: Floats, *, frame: Frame = "world") -> Freedom:
        """Return the rotation about the axis through `point` (3,) mm along `direction` (3,)."""
        w = _unit(direction, "direction of the axis")
        return cls(np.r_[-hat(w) @ frozen(point, "point of the axis", (3,)), w][:, None], frame)

    @classmethod
    def along(cls, direction: Floats, *, frame: Frame = "world") -> Freedom:
        """Return the translation along `direction` (3,)."""
        return cls(np.r_[_unit(direction, "direction"), np.zeros(3)][:, None], frame)

    def among(self, twists: Array, world_from_part: Rigid, *, center: Floats = (0, 0, 0), radius: float = 1.0) -> Array:
        """Return those motions (6, j) that twists (6, k) of the part span and that are free at a pose, orthonormal.

        center (3,), radius, mm: of the part. A motion counts as spanned if it moves the part by no more than `_SPANNED`
        of its radius beside one that is, for a turn of 1 rad: axes that were stated and those of a mesh are rounded.
        """
        B = self.at(world_from_part)
        if not twists.shape[1]:
            return np.zeros((6, 0))
        at = np.eye(6)  # from twists to (displacement of the centre in radii, turn)
        at[:3, :3], at[:3, 3:] = np.eye(3) / radius, -hat(frozen(center, "center", (3,))) / radius
        F, T = np.linalg.qr(at @ B)[0], np.linalg.qr(at @ twists)[0]
        both = F @ np.linalg.svd(T.T @ F)[2].T[:, : T.shape[1]]
        spanned = both[:, np.linalg.norm(both - T @ (T.T @ both), axis=0) < _SPANNED]
        return np.asarray(np.linalg.qr(np.linalg.solve(at, spanned))[0])

    def without(self, twists: Array, world_from_part: Rigid) -> Freedom:
        """Return this freedom less twists (6, k) of the part, orthonormal and free at a pose: there it stays.

        Where nothing would be left, or nothing is taken, it is the freedom itself.
        """
        B = self.at(world_from_part)
        if not 0 < twists.shape[1] < B.shape[1]:
            return self
        return Freedom(B @ np.linalg.svd(twists.T @ B)[2][twists.shape[1] :].T)

    def at(self, world_from_part: Rigid) -> Array:
        """Return B (6, k), orthonormal columns: the twists xi of `world_from_part @ Rigid.exp(xi)` that are free.

        A world twist z moves the part by exp(z) T = T exp(Ad(T^-1) z).
        """
        if self is FREE:
            return self.basis
        own = self.basis if self.frame == "part" else world_from_part.inv.adjoint() @ self.basis
        return np.asarray(np.linalg.qr(own)[0])


FREE = Freedom()


def aligned(B: Array, point: Array, sight: Array) -> Array:
    """Return a basis (6, k) of the span of B (6, k) made, as far as possible, of motions along and about three axes.

    point (3,), mm, is where the axes meet, on the part; sight (3,) is the last of them, from a camera to that point, in
    the part's frame. In such a basis a solver may damp each motion by itself. In other axes coming nearer is mixed with
    sliding where the part is far from the camera, and turning with sliding where it is far from its frame's origin.
    """
    along = sight / np.linalg.norm(sight)
    axes = np.array([*axes_across(along), along]).T
    screws = np.zeros((6, 6))
    screws[:3, :3], screws[:3, 3:], screws[3:, 3:] = axes, hat(point) @ axes, axes
    if B.shape[1] == 6:
        return screws
    Q = np.linalg.qr(np.linalg.solve(screws, B))[0]
    return np.asarray(screws @ Q @ np.linalg.eigh(Q.T @ (np.arange(6.0)[:, None] * Q))[1])


def carried(pose: Rigid, B: Array, x: Array, point: Array) -> Rigid:
    """Return the pose moved by the twist B x of B (6, k): translated, and rotated about a point (3,) of the part.

    To first order that is pose @ Rigid.exp(B x). But a screw motion that brings the part nearer by a share d of its
    distance, and turns it by w, also moves it aside by d w / 2 of that distance: through a long lens that is far more
    px than either. The screw is used only where B does not span the translation and the rotation each by itself.
    """
    xi = B @ x
    w, slide = xi[3:], xi[:3] + cross(xi[3:], point)
    if B.shape[1] < 6 and not (w.any() and slide.any() and _holds(B, slide, point)):
        return pose @ Rigid.exp(xi)
    turn = exp(w)
    return pose @ Rigid(turn, slide + point - turn @ point)


def _holds(B: Array, slide: Array, point: Array) -> bool:
    """Return whether the translation of a point by `slide` (3,) alone is among the motions that B (6, k) spans."""
    at = np.concatenate([B[:3] + np.cross(B[3:].T, point).T, B[3:]])  # how they move the point, and turn the part
    at[:3] /= np.linalg.norm(slide)
    Q = np.linalg.qr(at / np.linalg.norm(at, axis=0))[0]
    asked = np.append(slide / np.linalg.norm(slide), np.zeros(3))
    return bool(np.linalg.norm(Q @ (Q.T @ asked) - asked) < _WITHIN)


def _unit(direction: Floats, what: str) -> Array:
    v = frozen(direction, what, (3,))
    length = float(np.linalg.norm(v))
    if not length > 0:
        raise BadValue(what, v.tolist(), "three numbers, not all zero")
    return np.asarray(v / length)
