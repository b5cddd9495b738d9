"""Observations: world points, their pixels, and the source of the numbers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from hashlib import sha256

import numpy as np

from cadcam.arrays import Array, Floats, Locked, frozen
from cadcam.camera.camera import checked_size
from cadcam.camera.extended_pinhole import pixels_from_uv, uv_from_pixels
from cadcam.errors import BadValue
from cadcam.kinds import expect, expect_positive


@dataclass(frozen=True, slots=True, eq=False)
class Observations(Locked):
    """N world points (N, 3) in mm and their pixels q = (column, row) (N, 2), with a name each.

    sigma_px: standard deviation of one pixel coordinate if known; None lets an estimate derive it from its residuals.
    source, sha256: the file the points came from; for points made in memory the hash is of the numbers themselves.
    names: default "1", "2", ... A number that is not finite is refused with the point's name.
    """

    p_world: Array
    q: Array
    names: tuple[str, ...] = ()
    sigma_px: float | None = None
    source: str = "memory"
    sha256: str = ""

    def __post_init__(self) -> None:
        p = frozen(self.p_world, "world points", (None, 3), finite=False)
        q = frozen(self.q, "pixels", (None, 2), finite=False)
        names = tuple(str(n) for n in self.names) or tuple(str(i + 1) for i in range(len(p)))
        if not len(p) == len(q) == len(names):
            raise BadValue("number of world points, pixels, names", (len(p), len(q), len(names)), "one number for all")
        _refuse_not_finite(p, names, "XYZ")
        _refuse_not_finite(q, names, ("column", "row"))
        expect(self.source, "source", str)
        expect(self.sha256, "sha256", str)
        if self.sigma_px is not None:
            expect_positive(self.sigma_px, "sigma_px", "a positive number of pixels, one for all points")
        object.__setattr__(self, "p_world", p)
        object.__setattr__(self, "q", q)
        object.__setattr__(self, "names", names)
        object.__setattr__(self, "sha256", self.sha256 or sha256(p.tobytes() + q.tobytes()).hexdigest())

    @classmethod
    def from_uv(
        cls,
        p_world: Floats,
        UV: Floats,
        *,
        names: tuple[str, ...] = (),
        sigma_px: float | None = None,
        source: str = "memory",
        sha256: str = "",
    ) -> Observations:
        """Return the observations from the thesis' image points (U, V), U down and V to the right, (N, 2) px."""
        q = pixels_from_uv(frozen(UV, "image points (U, V)", (None, 2), finite=False))
        return cls(frozen(p_world, "world points", (None, 3), finite=False), q, names, sigma_px, source, sha256)

    @property
    def UV(self) -> Array:
        """Return the pixels as the thesis writes them, (U, V) = (row, column), (N, 2)."""
        return uv_from_pixels(self.q)

    def __len__(self) -> int:
        return len(self.p_world)

    def __repr__(self) -> str:
        sigma = "" if self.sigma_px is None else f", sigma {self.sigma_px:g} px"
        return f"Observations({len(self)} points from {self.source}{sigma})"


def picture_size(size: object, views: Sequence[Observations]) -> tuple[int, int]:
    """Return (width, height) in px; `BadValue` for what is no size, or one with its numbers exchanged.

    They are where points lie beyond the picture, and all would lie in one of (height, width).
    """
    width, height = checked_size(size)
    turned = (height, width)
    for view in views:
        beyond = np.flatnonzero((view.q > np.array([width, height]) - 0.5).any(axis=1))
        if beyond.size and all((v.q <= np.array(turned) - 0.5).all() for v in views):
            name, (x, y) = view.names[int(beyond[0])], view.q[beyond[0]]
            why = f"(width, height) px, as point {name!r} is at x = {x:.6g}, y = {y:.6g}"
            raise BadValue("size", (width, height), f"{turned}: {why}")
    return width, height


def _refuse_not_finite(values: Array, names: tuple[str, ...], axes: Sequence[str]) -> None:
    bad = np.argwhere(~np.isfinite(values))
    if len(bad):
        row, column = (int(i) for i in bad[0])
        more = f" ({len(bad)} such numbers in all)" if len(bad) > 1 else ""
        raise BadValue(
            f"{axes[column]} of point {names[row]!r}",
            f"{values[row, column]}{more}",
            "a finite number; or leave it out",
        )
