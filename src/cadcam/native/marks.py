"""The picture of a mark with its derivatives in the C core (mark.h), as functions of arrays."""

from __future__ import annotations

import ctypes as c
from dataclasses import dataclass
from functools import cache

import numpy as np

from cadcam.arrays import Array, Ids, Mask
from cadcam.errors import BadValue
from cadcam.native.core import addresses, doubles, functions

_MOST_RADII, _MOST_TERMS = 128, 16  # CC_MARK_RADII, CC_MARK_TERMS
_LEVELS, _ALWAYS, LOOSE = 8, 5, 3  # c s m gx gy b dx dy: the first always with derivatives, the last on request


class _Mark(c.Structure):
    _fields_ = (
        *((name, c.c_void_p) for name in ("radii", "rays", "sectors", "span")),
        *((name, c.c_int32) for name in ("n_radii", "n_sectors")),
    )


@cache
def _core() -> c.CDLL:
    i64, i32, arrays = c.c_int64, c.c_int32, [c.c_void_p] * 2
    arguments = [c.POINTER(_Mark), i64, i64, i32, c.c_void_p, *arrays, i32, *arrays, i32, *arrays]
    return functions("the fit of marks", {"cc_mark_picture": (None, arguments)})


@dataclass(frozen=True, slots=True, eq=False)
class Borders:
    """Sectors of rings in the core's format: the distinct radii and rays that bound them.

    radii (R,) mm; rays (A, 2) unit vectors; sectors (K, 4): indices of inner, outer, start and stop, -1 for none; span
    (K,) rad.
    """

    radii: Array
    rays: Array
    sectors: Ids
    span: Array

    @classmethod
    def of(cls, sectors: Array, whole: Mask) -> Borders:
        """Return the borders of sectors (K, 4): inner and outer radius, from and to in rad; whole (K,): no rays."""
        radii, at = np.unique(sectors[:, :2], return_inverse=True)
        at = at.reshape(-1, 2)
        if radii[0] == 0:
            radii, at = radii[1:], at - 1
        if len(radii) > _MOST_RADII:
            raise BadValue("radii", f"{len(radii)} different ones", f"at most {_MOST_RADII} borders of a mark")
        turn = sectors[:, 2:].ravel()
        rays = np.where(whole[:, None], -1, np.arange(len(turn)).reshape(-1, 2))
        return cls(
            np.ascontiguousarray(radii, np.float64),
            np.ascontiguousarray(np.stack([np.cos(turn), np.sin(turn)], axis=-1), np.float64),
            np.ascontiguousarray(np.hstack([at, rays]), np.int32),
            np.ascontiguousarray(sectors[:, 3] - sectors[:, 2], np.float64),
        )

    def _structure(self) -> _Mark:
        arrays = addresses(self.radii, self.rays, self.sectors, self.span)
        return _Mark(*arrays, len(self.radii), len(self.sectors))


def picture(borders: Borders, places: Array, H: Array, levels: Array) -> Array:
    """Return the grey values (B, P) at places (B, P, 2 or 8) for H (B, 3, 3), levels (B, 8): c s m gx gy b dx dy."""
    return _drawn(borders, places, H, np.zeros((len(H), 0, 3, 3)), levels, None, slopes=False, loose=0)[0]


def picture_with_slopes(
    borders: Borders, places: Array, H: Array, dH: Array, levels: Array, *, loose: int, weight: Array | None = None
) -> tuple[Array, Array]:
    """Return grey values (B, P) and derivatives (B, P, k + 5 + loose) by x y * * c s m gx gy and more; dH (B, k, 3, 3).

    loose: how many of b dx dy are included, at the end. weight (B, P): where it is 0, nothing is computed: all is 0.
    """
    if not 4 <= dH.shape[1] <= _MOST_TERMS:
        raise BadValue("slopes of H", f"by {dH.shape[1]} parameters", f"4 to {_MOST_TERMS}")
    return _drawn(borders, places, H, dH, levels, weight, slopes=True, loose=loose)


def _drawn(
    borders: Borders,
    places: Array,
    H: Array,
    dH: Array,
    levels: Array,
    weight: Array | None,
    *,
    slopes: bool,
    loose: int,
) -> tuple[Array, Array]:
    count, pixels, width = places.shape
    if width not in (2, 8) or H.shape != (count, 3, 3) or levels.shape != (count, _LEVELS):
        raise BadValue("places", f"of shape {places.shape} for H {H.shape}", "(B, P, 2 or 8), H (B, 3, 3)")
    if weight is not None and weight.shape != (count, pixels):
        raise BadValue("weight", f"of shape {weight.shape} for places {places.shape}", "one of each pixel")
    places, H, dH, levels = doubles(places, H, dH, levels)
    weights = None if weight is None else doubles(weight)[0]
    value = np.zeros((count, pixels))
    slope = np.zeros((count, pixels, dH.shape[1] + _ALWAYS + loose) if slopes else 0)
    mark = borders._structure()
    answers = (value.ctypes.data, slope.ctypes.data if slopes else None)
    inputs = (
        None if weights is None else weights.ctypes.data,
        H.ctypes.data,
        dH.shape[1],
        dH.ctypes.data,
        levels.ctypes.data,
        loose,
    )
    _core().cc_mark_picture(c.byref(mark), count, pixels, width, places.ctypes.data, *inputs, *answers)
    return value, slope
