"""Correlation in the C core: reduced pictures, the search over a grid, the climb to sub-pixel peaks.

The interface is src/cadcam/native/correlate.h. Inputs are checked and made contiguous here; callers see arrays.
"""

from __future__ import annotations

import ctypes as c
from dataclasses import dataclass
from functools import cache

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Array, Ids, Picture
from cadcam.errors import BadValue, NotEnoughMemory
from cadcam.native.core import addresses, functions

_LARGEST_FACTOR = 1024  # largest reduction: STRIP in correlate.c
# Of what the best of a template's motions shows (squared): below are the steps of eight bits, which no picture shares
_NOT_SHOWN = 1e-5
_LONGEST = 32767  # px along a side: an index into the picture fits 31 bits


class _Plane(c.Structure):
    _fields_ = (("pixels", c.c_void_p), ("width", c.c_int32), ("height", c.c_int32))


class _Search(c.Structure):
    _fields_ = (
        ("plane", _Plane),
        *((name, c.c_void_p) for name in ("dx", "dy", "weight", "inside")),
        *((name, c.c_int32) for name in ("taps", "count", "masks", "either_sign")),
        ("least_variance", c.c_float),
        ("best", c.c_void_p),
        ("which", c.c_void_p),
    )


class _Register(c.Structure):
    _fields_ = (
        ("plane", _Plane),
        *((name, c.c_void_p) for name in ("u", "v", "value", "slope", "inverse")),
        *((name, c.c_int32) for name in ("n", "motions", "cubic", "iterations")),
        *((name, c.c_double) for name in ("settled", "reach", "radius")),
    )


class _Spots(c.Structure):
    _fields_ = (
        ("plane", _Plane),
        *((name, c.c_int32 * 8) for name in ("dx_in", "dy_in", "dx_out", "dy_out")),
        ("reach", c.c_int32),
        ("dark", c.c_int32),
        ("level", c.c_float),
        ("response", c.c_void_p),
    )


@cache
def _core() -> c.CDLL:
    pointer, i32 = c.c_void_p, c.c_int32
    return functions(
        "the matching of templates",
        {
            "cc_shrink": (None, [pointer, i32, pointer]),
            "cc_find_spots": (None, [pointer]),
            "cc_search_rows": (i32, [pointer, i32, i32]),
            "cc_register_poses": (i32, [pointer, pointer, pointer, i32]),
            "cc_register_pulls": (i32, [pointer, i32, pointer, pointer, pointer, i32]),
        },
    )


@dataclass(frozen=True, slots=True, eq=False)
class Orientations:
    """A template on the grid of a reduced picture: taps at (dx, dy) (T,), weight (K, T) in each of K orientations.

    weight has zero mean and unit norm over the taps that count; inside (1 or K, T) says which do. spare: by how many
    px the taps of all reach, on some side, beyond those that count in one.
    """

    dx: Ids
    dy: Ids
    weight: Picture
    inside: Picture
    spare: int

    @classmethod
    def of(cls, dx: Array, dy: Array, weight: Array, inside: npt.ArrayLike) -> Orientations:
        """Return the orientations in the core's format."""
        x, y = (np.ascontiguousarray(a, np.int32) for a in (dx, dy))
        kept = np.ascontiguousarray(inside, np.float32)
        reaches = (np.where(kept > 0, a, 0).max(axis=1, initial=0) for a in (x, -x, y, -y))
        spare = max(int(np.ptp(reach)) for reach in reaches)
        return cls(x, y, np.ascontiguousarray(weight, np.float32), kept, spare)

    def __post_init__(self) -> None:
        taps = len(self.dx)
        if self.weight.shape[1:] != (taps,) or self.inside.shape not in ((1, taps), self.weight.shape):
            raise BadValue("orientations", f"of shape {self.weight.shape}", f"shape (K, {taps})")


@dataclass(frozen=True, slots=True, eq=False)
class Points:
    """A template as N points (u, v) about its origin, px: value (N,) and slope (m, N), its derivative by m motions.

    value has zero mean and unit norm, slope is orthogonal to it and to constants; inverse (m, m) of slope seen^T, seen
    the slopes of what a picture shows; radius px contains all points. Arrays are padded with zeros to a multiple of 8.
    """

    u: Picture
    v: Picture
    value: Picture
    slope: Picture
    inverse: Array
    count: int
    radius: float

    @classmethod
    def of(cls, u: Array, v: Array, value: Array, slope: Array, *, seen: Array | None = None) -> Points:
        """Return the points, their arrays padded; `seen` (m, N) is `slope` by default."""
        spare = -len(u) % 8

        def filled(a: Array) -> Picture:
            return np.ascontiguousarray(np.concatenate([a, np.zeros((*a.shape[:-1], spare))], axis=-1), np.float32)

        radius = float(np.hypot(u, v).max(initial=0.0))
        rim = max(float(np.sqrt(np.mean(u * u + v * v))), 1e-9)
        per_px = np.array([1.0, 1.0, 1 / rim, 1 / rim])[: len(slope)]
        inverse = np.ascontiguousarray(_inverse(slope @ (slope if seen is None else seen).T, per_px))
        return cls(filled(u), filled(v), filled(value), filled(slope), inverse, len(u), radius)


def _inverse(A: Array, per_px: Array) -> Array:
    """Return the inverse; of motions that do not show, as along an edge without noise, one that does not move by them.

    per_px: of each motion, what moves the rim by a px, as px and rad have nothing to do with each other.
    """
    return np.asarray(per_px[:, None] * np.linalg.pinv(per_px[:, None] * A * per_px, rcond=_NOT_SHOWN) * per_px)


def shrunken(picture: Picture, factor: int) -> Picture:
    """Return the means over blocks of factor x factor px; the last block of a row or column may be smaller."""
    plane, kept = _plane(picture)
    if not 1 <= factor <= _LARGEST_FACTOR:
        raise BadValue("factor", factor, f"a whole number from 1 to {_LARGEST_FACTOR}")
    out = np.zeros([-(-n // factor) for n in kept.shape], np.float32)
    _core().cc_shrink(c.addressof(plane), factor, out.ctypes.data)
    return out


def spot_steps(picture: Picture, inner: Ids, outer: Ids, *, dark: bool, level: float) -> Picture:
    """Return the second weakest of eight brightness steps (H, W) from inner to outer (8, 2) px about each pixel.

    A step is (outside - inside) / (outside + inside), or its negative unless `dark`; sums below `level` count as that.
    -1 where a step leaves the picture.
    """
    plane, kept = _plane(picture)
    if inner.shape != (8, 2) or outer.shape != (8, 2):
        raise BadValue("steps", f"of shapes {inner.shape} and {outer.shape}", "shape (8, 2)")
    reach = int(max(np.abs(inner).max(), np.abs(outer).max()))
    response = np.full(kept.shape, -1.0, np.float32)
    steps = [(c.c_int32 * 8)(*column.tolist()) for column in (*inner.T, *outer.T)]
    task = _Spots(plane, *steps, reach, dark, level, response.ctypes.data)
    _core().cc_find_spots(c.addressof(task))
    return response


def searched(
    picture: Picture, template: Orientations, *, least_variance: float, either_sign: bool = False
) -> tuple[Picture, Ids]:
    """Return each pixel's best correlation and its orientation (H, W); 0 and -1 where the template does not fit."""
    plane, kept = _plane(picture)
    best, which = np.zeros(kept.shape, np.float32), np.full(kept.shape, -1, np.int32)
    task = _Search(
        plane,
        *addresses(template.dx, template.dy, template.weight, template.inside),
        len(template.dx),
        len(template.weight),
        len(template.inside),
        either_sign,
        least_variance,
        best.ctypes.data,
        which.ctypes.data,
    )
    if _core().cc_search_rows(c.addressof(task), 0, len(kept)):
        raise NotEnoughMemory(f"there is not enough memory to search {kept.shape[1]} x {kept.shape[0]} px")
    return best, which


def registered(
    picture: Picture, template: Points, pose: Array, *, cubic: bool, iterations: int, settled: float, reach: float
) -> tuple[Array, Array]:
    """Return poses (N, 4) of highest correlation near those given, and that (N,); 0 where one moved beyond `reach`.

    A pose is x, y (px), angle (rad, x towards y), scale: template point (u, v) lies at (x, y) + scale R(angle) (u, v).
    """
    plane, kept = _plane(picture)
    moved = np.array(pose, np.float64).reshape(-1, 4)
    score = np.zeros(len(moved))
    if not (np.isfinite(moved).all() and np.all(np.abs(moved) < 1e6)):
        raise BadValue("start of a match", moved.tolist(), "finite numbers within the picture")
    task = _register(plane, template, cubic, iterations, settled, reach)
    if _core().cc_register_poses(c.addressof(task), moved.ctypes.data, score.ctypes.data, len(moved)):
        raise _no_memory(kept)
    return moved, np.clip(score, -1.0, 1.0)  # sums are in single precision


def pulls(picture: Picture, template: Points, pose: Array, side: int) -> tuple[Array, Array]:
    """Return the second moments (N, m, m) of J r at poses (N, 4), and J Jp^T (N, m, m).

    J are the template's slopes, Jp the picture's, r is what the template does not explain; in grey levels of the
    template, whose points lie whole px apart. What two of them say counts as one matter by how much squares of `side`
    px, a power of two, about them share.
    """
    plane, kept = _plane(picture)
    poses, motions = np.ascontiguousarray(pose, np.float64).reshape(-1, 4), len(template.slope)
    moment, shown = np.zeros((2, len(poses), motions, motions))
    task = _register(plane, template, True)
    if _core().cc_register_pulls(c.addressof(task), side, *addresses(poses, moment, shown), len(poses)):
        raise _no_memory(kept)
    return moment, shown


def _register(
    plane: _Plane, template: Points, cubic: bool, iterations: int = 0, settled: float = 0.0, reach: float = 0.0
) -> _Register:
    if min(plane.width, plane.height) < 2:
        raise BadValue("picture", f"of shape {(plane.height, plane.width)}", "at least 2 px along each side")
    return _Register(
        plane,
        *addresses(template.u, template.v, template.value, template.slope, template.inverse),
        template.count,
        len(template.slope),
        cubic,
        iterations,
        settled,
        reach,
        template.radius,
    )


def _no_memory(picture: Picture) -> NotEnoughMemory:
    return NotEnoughMemory(f"there is not enough memory to match in {picture.shape[1]} x {picture.shape[0]} px")


def _plane(picture: npt.ArrayLike) -> tuple[_Plane, Picture]:
    """Return the core's view of a picture, and the array that must be kept alive while it is used."""
    kept = np.ascontiguousarray(picture, np.float32)
    if kept.ndim != 2 or not kept.size or max(kept.shape) > _LONGEST:
        raise BadValue("picture", f"of shape {kept.shape}", f"(H, W), sides from 1 to {_LONGEST} px")
    return _Plane(kept.ctypes.data, kept.shape[1], kept.shape[0]), kept
