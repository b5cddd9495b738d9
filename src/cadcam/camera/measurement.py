"""Points measured by cameras: where, how well, by what, and together."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np

from cadcam.arrays import Array, Ids, frozen
from cadcam.camera.viewpoint import ErrorSource
from cadcam.errors import BadValue, UnknownName

PIXELS = "pixels"


@dataclass(frozen=True, slots=True)
class Length:
    """A distance and its standard deviation, mm."""

    value: float
    sigma: float


@dataclass(frozen=True, slots=True, eq=False)
class Measurement:
    """N points (N, 3) in mm, in the world of the cameras, with everything that their uncertainty consists of.

    from_pixels (N, 3, 3): covariance due to the noise of each point's own pixels, independent from point to point.
    effects: for each error source how all points move with its numbers, (N, 3, k): shared by the points, so that what
    is measured together errs together. seen_by: the viewpoints of each point. chi2 (N,), dof (N,): the misfit of each
    point's rays by what pixels, calibration and motion allow, and its degrees of freedom. gap, gap_sigma (N,) mm: the
    largest shortest distance between two of its rays and its predicted standard deviation; angle (N,) rad: the largest
    angle between two of its rays; NaN for points of one ray. refused: the points that could not be measured, and why.
    """

    names: tuple[str, ...]
    points: Array
    from_pixels: Array
    effects: tuple[tuple[ErrorSource, Array], ...]
    seen_by: tuple[tuple[str, ...], ...]
    chi2: Array
    dof: Ids
    gap: Array
    gap_sigma: Array
    angle: Array
    refused: Mapping[str, str] = field(default_factory=dict)
    method: str = ""

    def __post_init__(self) -> None:
        n = len(self.names)
        if len(set(self.names)) != n:
            raise BadValue("point names", self.names, "each name once")
        object.__setattr__(self, "points", frozen(self.points, "measured points", (n, 3)))
        object.__setattr__(self, "from_pixels", frozen(self.from_pixels, "covariance from pixels", (n, 3, 3)))
        effects = tuple((s, frozen(E, f"effect of {s.name}", (n, 3, len(s.covariance)))) for s, E in self.effects)
        object.__setattr__(self, "effects", effects)
        for name in ("chi2", "gap", "gap_sigma", "angle"):
            object.__setattr__(self, name, frozen(getattr(self, name), name, (n,), finite=False))
        object.__setattr__(self, "dof", frozen(self.dof, "dof", (n,), np.int32))
        object.__setattr__(self, "refused", MappingProxyType(dict(self.refused)))

    def __len__(self) -> int:
        return len(self.names)

    @property
    def covariance(self) -> Array:
        """Return the covariance (N, 3, 3) mm^2 of each point by itself."""
        total = self.from_pixels.copy()
        for source, E in self.effects:
            total += E @ source.covariance @ np.swapaxes(E, -1, -2)
        return np.asarray(total)

    @property
    def sigma(self) -> Array:
        """Return the standard deviations (N, 3) mm of X, Y, Z."""
        return np.asarray(np.sqrt(np.diagonal(self.covariance, axis1=-2, axis2=-1)))

    @property
    def p_value(self) -> Array:
        """Return how probable a misfit as large as each point's is, (N,); NaN without degrees of freedom."""
        from scipy.special import chdtrc

        p = chdtrc(np.maximum(self.dof, 1), np.nan_to_num(self.chi2))
        return np.asarray(np.where(self.dof > 0, p, np.nan))

    def budget(self) -> dict[str, Array]:
        """Return the standard deviations (N, 3) mm by cause: pixels, each calibration, each motion.

        Their squares add up to those of `sigma`; causes of one name are taken together.
        """
        parts = {PIXELS: np.diagonal(self.from_pixels, axis1=-2, axis2=-1).copy()}
        for source, E in self.effects:
            variance = np.einsum("nij,jk,nik->ni", E, source.covariance, E)
            parts[source.name] = parts.get(source.name, 0.0) + variance
        return {name: np.asarray(np.sqrt(np.maximum(variance, 0.0))) for name, variance in parts.items()}

    def point(self, name: str) -> Array:
        """Return one point (3,) mm."""
        return np.asarray(self.points[self._index(name)])

    def joint_covariance(self, *names: str) -> Array:
        """Return the covariance (3 M, 3 M) mm^2 of M points together, in the order of the names (default: all)."""
        index = [self._index(n) for n in names] if names else list(range(len(self)))
        total = np.zeros((3 * len(index),) * 2)
        for row, i in enumerate(index):
            total[3 * row : 3 * row + 3, 3 * row : 3 * row + 3] = self.from_pixels[i]
        for source, E in self.effects:
            stacked = E[index].reshape(3 * len(index), -1)
            total += stacked @ source.covariance @ stacked.T
        return total

    def distance(self, one: str, other: str) -> Length:
        """Return the distance between two points; its sigma knows what their errors have in common."""
        d = self.point(other) - self.point(one)
        length = float(np.linalg.norm(d))
        if one == other or length == 0:
            raise BadValue("the distance", f"between {one!r} and {other!r} at the same place", "two different points")
        gradient = np.concatenate([-d, d]) / length
        return Length(length, float(np.sqrt(gradient @ self.joint_covariance(one, other) @ gradient)))

    def inconsistent(self, *, p_below: float = 1e-3) -> tuple[str, ...]:
        """Return the names of the points whose rays miss each other more than chance allows, the worst first."""
        p = np.nan_to_num(self.p_value, nan=1.0)
        ratio = self.chi2 / np.maximum(self.dof, 1)
        return tuple(self.names[i] for i in np.argsort(-np.nan_to_num(ratio)) if p[i] < p_below)

    def _index(self, name: str) -> int:
        if name in self.refused:
            raise BadValue(f"point {name!r}", f"not measured: {self.refused[name]}", "a measured point")
        if name not in self.names:
            raise UnknownName("point", name, self.names)
        return self.names.index(name)

    def __repr__(self) -> str:
        refused = f", {len(self.refused)} refused" if self.refused else ""
        return f"Measurement({len(self)} points{refused}, {self.method})"
