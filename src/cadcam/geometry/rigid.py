"""Rigid motions, `b_from_a`: p_b = b_from_a @ p_a."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any, NoReturn, overload

import numpy as np

from cadcam.arrays import Array, Floats, Index, Locked, frozen
from cadcam.errors import BadValue, DegenerateGeometry
from cadcam.geometry import rotation as so3
from cadcam.kinds import expect, expect_each, said


@dataclass(frozen=True, slots=True, eq=False)
class Rigid(Locked):
    """A rotation (..., 3, 3) followed by a translation (..., 3) in mm; leading axes are a batch.

    Tangent order: (translation, rotation). A perturbation acts on the right, `T @ Rigid.exp(xi)`: it lives in the
    frame that the motion starts from, and so does its 6x6 covariance.
    """

    __array_ufunc__ = None  # so that numpy leaves `array @ motion` to `__rmatmul__`

    rotation: Array = field(default_factory=lambda: np.eye(3))
    translation: Array = field(default_factory=lambda: np.zeros(3))

    def __post_init__(self) -> None:
        R = frozen(self.rotation, "rotation", (3, 3), batched=True)
        t = frozen(self.translation, "translation", (3,), batched=True)
        defect = float(np.abs(R @ np.swapaxes(R, -1, -2) - np.eye(3)).max(initial=0.0))
        if defect > so3.EXACT or not np.all(np.linalg.det(R) > 0):
            misfit = so3.misfit(defect, exact=so3.EXACT)
            raise BadValue("rotation", misfit, "an orthonormal, right-handed 3x3 matrix")
        if R.ndim > 2 and t.ndim > 1:
            try:
                np.broadcast_shapes(R.shape[:-2], t.shape[:-1])
            except ValueError:
                raise BadValue("translations", f"of shape {t.shape}", f"one for each of rotations {R.shape}") from None
        object.__setattr__(self, "rotation", R)
        object.__setattr__(self, "translation", t)

    @classmethod
    def _made(cls, rotation: Array, translation: Array) -> Rigid:
        """Return the motion of arrays computed from valid motions, without checks."""
        motion = object.__new__(cls)
        for name, array in (("rotation", rotation), ("translation", translation)):
            array.setflags(write=False)
            object.__setattr__(motion, name, array)
        return motion

    @classmethod
    def from_matrix(cls, matrix: Floats) -> Rigid:
        """Return the motion of a homogeneous (..., 4, 4) or (..., 3, 4) matrix, mm.

        A rotation that was rounded, to three decimals or more, is made orthonormal; what is none raises `BadValue`.
        """
        try:
            matrix = np.asarray(matrix, dtype=np.float64)
        except (TypeError, ValueError):
            raise BadValue("rigid motion", said(matrix), "a 4x4 or 3x4 matrix") from None
        if matrix.ndim < 2 or matrix.shape[-1] != 4 or matrix.shape[-2] not in (3, 4):
            raise BadValue("rigid motion", f"of shape {matrix.shape}", "a 4x4 or 3x4 matrix")
        if matrix.shape[-2] == 4 and not np.allclose(matrix[..., 3, :], [0, 0, 0, 1], rtol=0, atol=1e-12):
            raise BadValue("last row of the rigid motion", matrix[..., 3, :], "(0, 0, 0, 1)")
        R = frozen(matrix[..., :3, :3], "rotation", (3, 3), batched=True)
        return cls(so3.written(R), matrix[..., :3, 3])

    @classmethod
    def from_quaternion(cls, wxyz: Floats, translation: Floats = (0.0, 0.0, 0.0)) -> Rigid:
        """Return the motion of a quaternion (..., 4), w first (ROS and SciPy write it last), and a translation, mm."""
        q = frozen(wxyz, "quaternion (w, x, y, z)", (4,), batched=True)
        return cls(so3.from_quaternion(q), frozen(translation, "translation", (3,), batched=True))

    @classmethod
    def from_rotation_vector(cls, w: Floats, translation: Floats = (0.0, 0.0, 0.0)) -> Rigid:
        """Return the motion of a rotation vector (..., 3) in rad (OpenCV's rvec) and a translation (..., 3) in mm.

        Not `exp`, whose twist moves along a screw: its first three numbers are no translation.
        """
        vector = frozen(w, "rotation vector", (3,), batched=True)
        return cls(so3.exp(vector), frozen(translation, "translation", (3,), batched=True))

    @classmethod
    def stack(cls, motions: Iterable[Rigid]) -> Rigid:
        """Return the batch (N,) of single motions, such as `read_robot_poses(...).values()`; `each` is the inverse."""
        single = expect_each(motions, "motions", Rigid)
        for i, motion in enumerate(single):
            expect_motion(motion, f"motions[{i}]")
        R, t = [m.rotation for m in single], [m.translation for m in single]
        return cls._made(np.array(R).reshape(-1, 3, 3), np.array(t).reshape(-1, 3))

    @classmethod
    def look_at(cls, eye: Floats, target: Floats, *, up: Floats = (0.0, 0.0, 1.0)) -> Rigid:
        """Return camera_from_world of a camera at `eye` (mm) whose z axis meets `target`, with `up` upwards (-y)."""
        eye, target = frozen(eye, "eye", (3,)), frozen(target, "target", (3,))
        up = frozen(up, "up", (3,))
        forward = target - eye
        right = so3.cross(forward, up)
        scale = float(np.linalg.norm(forward)) * float(np.linalg.norm(up))
        if not np.linalg.norm(right) > 1e-9 * scale or scale == 0:
            raise DegenerateGeometry(f"looking from {eye} to {target} with up {up}: up must not lie along the view")
        z = forward / np.linalg.norm(forward)
        x = right / np.linalg.norm(right)
        R = np.stack([x, so3.cross(z, x), z])
        return cls(R, -R @ eye)

    @classmethod
    def exp(cls, xi: Floats) -> Rigid:
        """Return the motion of the twist xi = (translation, rotation), shape (..., 6)."""
        xi = frozen(xi, "twist", (6,), batched=True)
        R, V = so3.exp_and_left_jacobian(xi[..., 3:])
        return cls._made(R, _apply(V, xi[..., :3]))

    def log(self) -> Array:
        """Return the twist (..., 6) with `Rigid.exp(T.log())` equal to T, rotation angle <= pi."""
        w = so3.log(self.rotation)
        v = _apply(so3.inverse_left_jacobian(w), self.translation)
        return np.concatenate(np.broadcast_arrays(v, w), axis=-1)

    @property
    def inv(self) -> Rigid:
        """Return a_from_b."""
        Rt = np.swapaxes(self.rotation, -1, -2)
        return Rigid._made(Rt, -_apply(Rt, self.translation))

    @property
    def matrix(self) -> Array:
        """Return the homogeneous matrix (..., 4, 4)."""
        shape = np.broadcast_shapes(self.rotation.shape[:-2], self.translation.shape[:-1])
        out = np.zeros((*shape, 4, 4))
        out[..., :3, :3], out[..., :3, 3], out[..., 3, 3] = self.rotation, self.translation, 1.0
        return out

    @property
    def quaternion_wxyz(self) -> Array:
        """Return the rotation as a unit quaternion (..., 4), w first and not negative."""
        return so3.quaternion(self.rotation)

    @property
    def rotation_vector(self) -> Array:
        """Return the rotation as a vector (..., 3) in rad, as OpenCV's rvec; its length is the angle, <= pi."""
        return so3.log(self.rotation)

    @property
    def origin(self) -> Array:
        """Return the position of frame b's origin in frame a, (..., 3) mm: the camera centre of a camera_from_world."""
        return -_apply(np.swapaxes(self.rotation, -1, -2), self.translation)

    def adjoint(self) -> Array:
        """Return Ad (..., 6, 6): T exp(xi) T^-1 = exp(Ad xi), and cov(a_from_b) = Ad S Ad^T for S = cov(b_from_a)."""
        R = self.rotation
        shape = np.broadcast_shapes(R.shape[:-2], self.translation.shape[:-1])
        out = np.zeros((*shape, 6, 6))
        out[..., :3, :3] = out[..., 3:, 3:] = R
        out[..., :3, 3:] = so3.hat(self.translation) @ R
        return out

    @overload
    def __matmul__(self, other: Rigid) -> Rigid: ...
    @overload
    def __matmul__(self, other: Floats) -> Array: ...
    def __matmul__(self, other: Rigid | Floats) -> Rigid | Array:
        """Return c_from_a = c_from_b @ b_from_a, or the points p_b = b_from_a @ p_a of an array (..., 3).

        A single motion applies to any array of points; a batch of motions broadcasts against the points' leading
        axes (so N motions by N points pair up; add an axis to apply each motion to every point).
        """
        if isinstance(other, Rigid):
            t = _apply(self.rotation, other.translation) + self.translation
            return Rigid._made(self.rotation @ other.rotation, t)
        try:
            p = np.asarray(other, dtype=np.float64)
        except (TypeError, ValueError):
            raise BadValue("right of @", said(other), "a Rigid, or points (..., 3) in mm") from None
        if p.shape[-1:] != (3,):
            way = "a Rigid: cadcam.Rigid.from_matrix(matrix)" if p.shape[-2:] == (4, 4) else "points (..., 3) in mm"
            raise BadValue("right of @", said(other), way)
        return _apply(self.rotation, p) + self.translation

    def __rmatmul__(self, other: object) -> NoReturn:
        """Refuse an array on the left, which numpy would multiply with the motion element by element."""
        raise BadValue("left of @", said(other), "a Rigid: cadcam.Rigid.from_matrix(matrix)")

    def __getitem__(self, index: int | np.integer[Any] | slice | list[int] | Index) -> Rigid:
        """Return some motions of a batch (N, ...), or one of them, by an index of its first axis."""
        if self.rotation.ndim == 2 or self.translation.ndim == 1:
            raise BadValue("motion to take from", repr(self), "a batch of motions")
        return Rigid._made(self.rotation[index], self.translation[index])

    @property
    def each(self) -> list[Rigid]:
        """Return the motions of a batch (N,) as a list of single ones."""
        return [Rigid._made(R, t) for R, t in zip(self.rotation, self.translation, strict=True)]

    def __repr__(self) -> str:
        if self.rotation.ndim > 2 or self.translation.ndim > 1:
            return f"Rigid(batch {np.broadcast_shapes(self.rotation.shape[:-2], self.translation.shape[:-1])})"
        t = np.array2string(self.translation, precision=4)
        w = np.array2string(np.degrees(so3.log(self.rotation)), precision=4)
        return f"Rigid(translation {t} mm, rotation vector {w} deg)"


def expect_motion(motion: object, what: str, *, optional: bool = False) -> None:
    """Raise `BadValue` naming `what` unless it is a single motion; None passes where it is optional."""
    expect(motion, what, Rigid, optional=optional)
    if isinstance(motion, Rigid) and (motion.rotation.ndim > 2 or motion.translation.ndim > 1):
        raise BadValue(what, repr(motion), "a single motion: take one, such as [0]")


def by_twist(p: Array, by_point: Array) -> Array:
    """Return d/dxi (..., 6) of a quantity with derivative by_point (..., 3) by points p (..., 3) moved by exp(xi).

    dp = v + w x p; p broadcasts against by_point, and both are in the axes of xi: those of a in b_from_a @ exp(xi).
    """
    return np.concatenate([by_point, np.cross(p, by_point)], axis=-1)


def _apply(R: Array, p: Array) -> Array:
    if R.ndim == 2:  # one product for many points: the common case, and the fast one
        return np.asarray(p @ R.T)
    return np.asarray(np.einsum("...ij,...j->...i", R, p))
