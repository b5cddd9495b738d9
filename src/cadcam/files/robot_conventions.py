"""How the makers of robots write a pose in numbers: by name, read into a motion in mm and written back.

KUKA's angles, a rotation vector and Yaskawa's angles are three numbers each, and no number says which they are: so the
convention is always named.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from cadcam.arrays import Array, Floats, frozen
from cadcam.cad.units import MM, unit_name
from cadcam.errors import BadValue
from cadcam.geometry import rotation as so3
from cadcam.geometry.rigid import Rigid
from cadcam.kinds import expect, expect_known


@dataclass(frozen=True, slots=True)
class Convention:
    """Columns of a pose, position first; its unit of length ("" if the caller must give it); words; the rotation.

    rotation, cells: from the numbers of a rotation (n, m) to its matrices (n, 3, 3), and back. angle: their unit, "deg"
    or "rad"; "" where they are no angles.
    """

    columns: tuple[str, ...]
    unit: str
    meaning: str
    rotation: Callable[[Array], Array]
    cells: Callable[[Array], Array]
    angle: str = ""

    def poses(self, numbers: Array, *, unit: str | None = None) -> Rigid:
        """Return base_from_flange (n) in mm of numbers (n, columns). Raises `BadValue` for no or another unit."""
        mm = self._mm(unit)
        if len(self.columns) == len(_MATRIX):
            rows = numbers.reshape(-1, 3, 4)
            return Rigid(self.rotation(rows[..., :3]), rows[..., 3] * mm)
        return Rigid(self.rotation(numbers[:, 3:]), numbers[:, :3] * mm)

    def numbers(self, poses: Rigid, *, unit: str | None = None) -> Array:
        """Return the numbers (n, columns) of base_from_flange (n): the inverse of `poses`."""
        t = poses.translation / self._mm(unit)
        if len(self.columns) == len(_MATRIX):
            return np.concatenate([self.cells(poses.rotation), t[..., None]], axis=-1).reshape(len(t), -1)
        return np.concatenate([t, self.cells(poses.rotation)], axis=-1)

    def _mm(self, unit: str | None) -> float:
        expect(unit, "unit", str, optional=True)
        if not (unit or self.unit):
            raise BadValue("unit of the robot's positions", "not stated", "mm, m ...: this convention does not say")
        return MM[unit_name(unit or self.unit)]


def robot_poses(numbers: Floats, *, convention: str, unit: str | None = None) -> Rigid:
    """Return base_from_flange (mm) of a robot's own numbers (k,) or (n, k), as its controller shows or sends them.

    convention: one of `CONVENTIONS`, such as "kuka": X Y Z A B C; its columns and unit of length are those of that
    maker. unit: of the positions, where the convention does not say or it is another. Raises `BadValue`, `UnknownName`.
    """
    rule = _rule(convention)
    given = frozen(numbers, f"{convention} numbers ({' '.join(rule.columns)})", (len(rule.columns),), batched=True)
    found = rule.poses(given.reshape(-1, len(rule.columns)), unit=unit)
    return found[0] if given.ndim == 1 else found


def robot_numbers(poses: Rigid, *, convention: str, unit: str | None = None) -> Array:
    """Return the numbers (k,) or (n, k) by which a robot's controller writes one motion or a batch (n) of them.

    The inverse of `robot_poses`, for poses that a robot is sent to. Of the angles that mean the same rotation where the
    middle one is +-90 degrees (of "kawasaki" 0 or 180), one is 0.
    """
    expect(poses, "poses", Rigid)
    single = poses.rotation.ndim == 2
    numbers = _rule(convention).numbers(Rigid.stack([poses]) if single else poses, unit=unit)
    return numbers[0] if single else numbers


def _rule(convention: str) -> Convention:
    expect_known(convention, "robot pose convention", CONVENTIONS)
    return CONVENTIONS[convention]


def _about(axis: int, angle: Array) -> Array:
    return so3.exp(angle[..., None] * np.eye(3)[axis])


def _turned(axes: str, order: tuple[int, int, int] = (0, 1, 2)) -> Callable[[Array], Array]:
    """Return the rotation R = R_axes[0] R_axes[1] R_axes[2] of three angles in degrees, cells taken in `order`."""

    def rotation(angles: Array) -> Array:
        first, second, third = (
            _about("xyz".index(axis), np.radians(angles[:, i])) for axis, i in zip(axes, order, strict=True)
        )
        return np.asarray(first @ second @ third)

    return rotation


def _angles(axes: Literal["ZYX", "XYZ", "ZYZ"], order: tuple[int, int, int] = (0, 1, 2)) -> Callable[[Array], Array]:
    """Return the inverse of `_turned`."""

    def cells(R: Array) -> Array:
        from scipy.spatial.transform import Rotation

        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # where two axes coincide, SciPy takes one angle for 0
            angles = Rotation.from_matrix(R.copy()).as_euler(axes, degrees=True)  # older SciPy takes no read-only array
        return np.asarray(angles[:, np.argsort(order)])

    return cells


def _w_last(q: Array) -> Array:
    return so3.from_quaternion(q[:, [3, 0, 1, 2]])


def _to_w_last(R: Array) -> Array:
    return so3.quaternion(R)[:, [1, 2, 3, 0]]


def _rows(R: Array) -> Array:
    return R


_MATRIX = ("r11", "r12", "r13", "tx", "r21", "r22", "r23", "ty", "r31", "r32", "r33", "tz")
_FIXED_XYZ = (_turned("zyx", (2, 1, 0)), _angles("ZYX", (2, 1, 0)))  # these are pairs: from the numbers, and back
_W_FIRST, _W_LAST = (so3.from_quaternion, so3.quaternion), (_w_last, _to_w_last)
_VECTOR = (so3.exp, so3.log)
_QUATERNION = ("x", "y", "z", "qx", "qy", "qz", "qw")

CONVENTIONS: dict[str, Convention] = {
    "kuka": Convention(
        ("x", "y", "z", "a", "b", "c"),
        "mm",
        "A about Z, B about Y', C about X'', deg: R = Rz(A) Ry(B) Rx(C)",
        _turned("zyx"),
        _angles("ZYX"),
        angle="deg",
    ),
    "fanuc": Convention(
        ("x", "y", "z", "w", "p", "r"),
        "mm",
        "W, P, R about the fixed X, Y, Z, deg: R = Rz(R) Ry(P) Rx(W)",
        *_FIXED_XYZ,
        angle="deg",
    ),
    "yaskawa": Convention(
        ("x", "y", "z", "rx", "ry", "rz"),
        "mm",
        "Rx, Ry, Rz about the fixed X, Y, Z, deg: R = Rz Ry Rx",
        *_FIXED_XYZ,
        angle="deg",
    ),
    "staubli": Convention(
        ("x", "y", "z", "rx", "ry", "rz"),
        "mm",
        "Rx, then Ry', then Rz'', deg: R = Rx Ry Rz",
        _turned("xyz"),
        _angles("XYZ"),
        angle="deg",
    ),
    "kawasaki": Convention(
        ("x", "y", "z", "o", "a", "t"),
        "mm",
        "O about Z, A about Y', T about Z'', deg: R = Rz(O) Ry(A) Rz(T)",
        _turned("zyz"),
        _angles("ZYZ"),
        angle="deg",
    ),
    "abb": Convention(
        ("x", "y", "z", "q1", "q2", "q3", "q4"),
        "mm",
        "quaternion q1 (w) q2 q3 q4 (x y z)",
        *_W_FIRST,
    ),
    "ur": Convention(("x", "y", "z", "rx", "ry", "rz"), "m", "rotation vector, rad; position in m", *_VECTOR, "rad"),
    "rotation-vector": Convention(
        ("x", "y", "z", "rx", "ry", "rz"), "", "rotation vector, rad; unit stated", *_VECTOR, "rad"
    ),
    "quaternion-wxyz": Convention(
        ("x", "y", "z", "qw", "qx", "qy", "qz"),
        "",
        "quaternion, w first; unit stated",
        *_W_FIRST,
    ),
    "quaternion-xyzw": Convention(_QUATERNION, "", "quaternion, w last; unit stated", *_W_LAST),
    "ros": Convention(_QUATERNION, "m", "geometry_msgs/Pose: quaternion, w last; position in m", *_W_LAST),
    "matrix": Convention(_MATRIX, "", "rows of the 3x4 or 4x4 matrix; unit stated", so3.written, _rows),
}
