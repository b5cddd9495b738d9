"""Points measured by cameras: positions, uncertainty by cause, and their correlations."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from cadcam.arrays import Array, Brief, Ids, Locked, Longs, frozen
from cadcam.camera.error_source import ErrorSource
from cadcam.errors import BadValue
from cadcam.kinds import FrozenMap, expect_known

PIXELS = "pixels"
_NORMAL = 1e9  # degrees of freedom from which Student's distribution is taken as normal
_TOGETHER = 32  # points at each end of the pairs whose variances are worked out together


@dataclass(frozen=True, slots=True)
class Length:
    """A distance, its standard deviation and half of its 95 % interval, mm."""

    value: float
    sigma: float
    half_width: float


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class PixelNoise(Brief):
    """The covariance (N, 3, 3) mm^2 of points due to noise of one origin, independent between points: of pixels.

    owner, dof: the calibration that the noise was estimated by and its degrees of freedom; None and inf where stated.
    name: the cause, where it is not the pixels.
    """

    covariance: Array
    owner: object = field(default=None, repr=False)
    dof: float = np.inf
    name: str = PIXELS


@dataclass(frozen=True, slots=True, eq=False)
class Measurement(Locked):
    """N points (N, 3) in mm, in the world of the cameras, with all contributions to their uncertainty.

    noise: covariances due to what each point has to itself, such as its pixels. effects: for each error source the
    derivative (N, 3, k) of all points by its parameters: shared by the points, so that their errors are correlated.
    seen_by: the viewpoints of each point. chi2 (N,), dof (N,): the misfit of each point's rays relative to the
    uncertainty of pixels, calibration and motion, and its degrees of freedom. gap, gap_sigma (N,) mm: the largest
    shortest distance between two of its rays and its predicted standard deviation; angle (N,) rad: the largest angle
    between two of its rays; NaN for points of one ray. refused: the points that could not be measured, and why.
    """

    names: tuple[str, ...]
    points: Array
    noise: tuple[PixelNoise, ...]
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
        noise = tuple(
            replace(part, covariance=frozen(part.covariance, f"covariance from {part.name}", (n, 3, 3)))
            for part in self.noise
        )
        object.__setattr__(self, "noise", noise)
        effects = tuple((s, frozen(E, f"effect of {s.name}", (n, 3, len(s.covariance)))) for s, E in self.effects)
        object.__setattr__(self, "effects", effects)
        for name in ("chi2", "gap", "gap_sigma", "angle"):
            object.__setattr__(self, name, frozen(getattr(self, name), name, (n,), finite=False))
        object.__setattr__(self, "dof", frozen(self.dof, "dof", (n,), np.int32))
        object.__setattr__(self, "refused", FrozenMap(self.refused))

    def __len__(self) -> int:
        return len(self.names)

    @property
    def from_pixels(self) -> Array:
        """Return the covariance (N, 3, 3) mm^2 due to all pixels' noise, independent between points."""
        return self._of_noise(lambda part: part.name == PIXELS)

    def _of_noise(self, counts: Callable[[PixelNoise], bool] | None = None) -> Array:
        """Return the covariance (N, 3, 3) mm^2 due to noise of these origins, by default all, independent."""
        parts = (part.covariance for part in self.noise if counts is None or counts(part))
        return np.asarray(sum(parts, np.zeros((len(self), 3, 3))))

    @property
    def covariance(self) -> Array:
        """Return the covariance (N, 3, 3) mm^2 of each point by itself."""
        total = self._of_noise()
        for source, E in self.effects:
            total += _weighed(E, source.covariance) @ np.swapaxes(E, -1, -2)
        return np.asarray(total)

    @property
    def sigma(self) -> Array:
        """Return the standard deviations (N, 3) mm of X, Y, Z."""
        return np.asarray(np.sqrt(np.diagonal(self.covariance, axis1=-2, axis2=-1)))

    def half_width(self, *, coverage: float = 0.95) -> Array:
        """Return half the widths (N, 3) mm of the intervals that contain X, Y, Z with this probability.

        Student's t for noise that was estimated: effective degrees of freedom by Welch and Satterthwaite (GUM, G.4),
        the pixels' noise and a calibration's covariance taken as one where both come from the same residuals.
        """
        every = [_Variances.of(self, axis) for axis in np.eye(3)]
        return np.stack([np.sqrt(one.total) * one.student(coverage) for one in every], axis=-1)

    @property
    def p_value(self) -> Array:
        """Return the p-value of each point's misfit, (N,); NaN without degrees of freedom."""
        from scipy.special import chdtrc

        p = chdtrc(np.maximum(self.dof, 1), np.nan_to_num(self.chi2))
        return np.asarray(np.where(self.dof > 0, p, np.nan))

    def budget(self) -> dict[str, Array]:
        """Return the standard deviations (N, 3) mm by cause: pixels, each calibration, each motion.

        Their squares add up to those of `sigma`; causes of the same name are combined.
        """
        parts = {PIXELS: np.zeros((len(self), 3))}
        for source, E in self.effects:
            variance = np.einsum("nik,nik->ni", _weighed(E, source.covariance), E)
            parts[source.name] = parts.get(source.name, 0.0) + variance
        for part in self.noise:
            parts[part.name] = parts.get(part.name, 0.0) + np.diagonal(part.covariance, axis1=-2, axis2=-1)
        return {name: np.asarray(np.sqrt(np.maximum(variance, 0.0))) for name, variance in parts.items()}

    def point(self, name: str) -> Array:
        """Return one point (3,) mm."""
        return np.asarray(self.points[self._index(name)])

    def joint_covariance(self, *names: str) -> Array:
        """Return the covariance (3 M, 3 M) mm^2 of M points together, in the order of the names (default: all)."""
        index = [self._index(n) for n in names] if names else list(range(len(self)))
        total, own = np.zeros((3 * len(index),) * 2), self._of_noise()
        for row, i in enumerate(index):
            total[3 * row : 3 * row + 3, 3 * row : 3 * row + 3] = own[i]
        for source, E in self.effects:
            stacked = E[index].reshape(3 * len(index), -1)
            total += stacked @ source.covariance @ stacked.T
        return total

    def distance(self, one: str, other: str) -> Length:
        """Return the distance between two points; its sigma accounts for the correlation of their errors."""
        return self.distances([(one, other)])[0]

    def distances(self, pairs: Sequence[tuple[str, str]]) -> tuple[Length, ...]:
        """Return the `distance` of each pair of points; of many pairs in far less time than one by one."""
        if not pairs:
            return ()
        place = {name: i for i, name in enumerate(self.names)}
        ends = np.array([[place[n] if n in place else self._index(n) for n in pair] for pair in pairs])
        d = self.points[ends[:, 1]] - self.points[ends[:, 0]]
        length = np.linalg.norm(d, axis=1)
        if not length.all():
            one, other = pairs[int(np.argmin(length))]
            raise BadValue("the distance", f"between {one!r} and {other!r} at the same place", "two different points")
        found = _Variances.of_pairs(self, ends, d / length[:, None])
        sigma = np.sqrt(found.total)
        each = (length.tolist(), sigma.tolist(), (found.student(0.95) * sigma).tolist())
        return tuple(Length(*numbers) for numbers in zip(*each, strict=True))

    def inconsistent(self, *, p_below: float = 1e-3) -> tuple[str, ...]:
        """Return the names of the points whose rays miss each other more than chance allows, the worst first."""
        p = np.nan_to_num(self.p_value, nan=1.0)
        ratio = self.chi2 / np.maximum(self.dof, 1)
        return tuple(self.names[i] for i in np.argsort(-np.nan_to_num(ratio)) if p[i] < p_below)

    def _index(self, name: str) -> int:
        if name in self.refused:
            raise BadValue(f"point {name!r}", f"not measured: {self.refused[name]}", "a measured point")
        expect_known(name, "point", self.names)
        return self.names.index(name)

    def __repr__(self) -> str:
        refused = f", {len(self.refused)} refused" if self.refused else ""
        missed = len(self.inconsistent())
        doubt = f", {missed} whose rays miss each other: see .inconsistent()" if missed else ""
        return f"Measurement({len(self)} points{refused}{doubt}, {self.method})"


@dataclass(frozen=True, slots=True)
class _Variances:
    """Variances (n,) mm^2 of n numbers by the owner of their cause, whose degrees of freedom stand beside them."""

    by_owner: Mapping[int, tuple[float, Array]]

    @classmethod
    def of(cls, of: Measurement, gradient: Array) -> _Variances:
        """Return those of gradient (3,) . point for each of the points."""
        causes = [(p.owner, p.dof, np.einsum("i,nij,j->n", gradient, p.covariance, gradient)) for p in of.noise]
        for source, E in of.effects:
            along = np.einsum("i,nik->nk", gradient, E)
            causes.append((source.owner, source.dof, np.sum(along @ source.covariance * along, axis=1)))
        return cls._summed(causes)

    @classmethod
    def of_pairs(cls, of: Measurement, ends: Longs, direction: Array) -> _Variances:
        """Return those of direction (n, 3) . (second - first point) for n pairs of points, by their indices (n, 2)."""
        blocks = [_Block.of(ends, direction, which) for which in _blocks(ends)]

        def spread(parts: Iterable[Array]) -> Array:
            out = np.zeros(len(ends))
            for block, part in zip(blocks, parts, strict=True):
                out[block.which] = part
            return out

        causes = [(p.owner, p.dof, spread(b.of_noise(p.covariance) for b in blocks)) for p in of.noise]
        causes += [(s.owner, s.dof, spread(b.of_effect(E, s.covariance) for b in blocks)) for s, E in of.effects]
        return cls._summed(causes)

    @classmethod
    def _summed(cls, causes: Iterable[tuple[object, float, Array]]) -> _Variances:
        """Return the variances of causes of one owner added up."""
        by_owner: dict[int, tuple[float, Array]] = {}
        for owner, dof, variance in causes:
            before = by_owner.get(id(owner))
            by_owner[id(owner)] = (dof, variance) if before is None else (before[0], before[1] + variance)
        return cls(by_owner)

    @property
    def total(self) -> Array:
        """Return the variances (n,) by all causes."""
        return np.asarray(np.sum([variance for _, variance in self.by_owner.values()], axis=0))

    def student(self, coverage: float) -> Array:
        """Return the factors (n,) of Student's t, for effective degrees of freedom by Welch and Satterthwaite."""
        from scipy.special import stdtrit

        doubt = np.sum([variance**2 / dof for dof, variance in self.by_owner.values()], axis=0)
        with np.errstate(divide="ignore", invalid="ignore"):
            effective = np.where(doubt > 0, self.total**2 / doubt, np.inf)
        return np.asarray(stdtrit(np.minimum(effective, _NORMAL), 0.5 + 0.5 * coverage))


@dataclass(frozen=True, slots=True, eq=False)
class _Block:
    """Pairs of few points: which of all they are, the points' indices, and each pair's ends (n, 2) among these.

    direction (n, 3): that along which the difference counts, second less first.
    """

    which: Longs
    points: Longs
    ends: Longs
    direction: Array

    @classmethod
    def of(cls, ends: Longs, direction: Array, which: Longs) -> _Block:
        """Return the block of these of all pairs."""
        points, flat = np.unique(ends[which], return_inverse=True)
        return cls(which, points, flat.reshape(-1, 2), direction[which])

    def of_noise(self, covariance: Array) -> Array:
        """Return the variances (n,) by noise that is independent between points, of covariance (N, 3, 3)."""
        own = covariance[self.points]
        both = own[self.ends[:, 0]] + own[self.ends[:, 1]]
        return np.asarray(np.einsum("ni,nij,nj->n", self.direction, both, self.direction))

    def of_effect(self, E: Array, covariance: Array) -> Array:
        """Return the variances (n,) by parameters of this covariance (k, k) that move all points by E (N, 3, k)."""
        own = E[self.points]
        used = np.flatnonzero(own.any(axis=(0, 1)))  # a gantry's visits have a column each: few points use few
        own = own[:, :, used]
        along = np.einsum("ni,nik->nk", self.direction, own[self.ends[:, 1]] - own[self.ends[:, 0]])
        return np.asarray(np.sum(along @ covariance[np.ix_(used, used)] * along, axis=1))


def _blocks(ends: Longs) -> list[Longs]:
    """Return the indices of pairs (n, 2) of points in blocks: of each, both ends are among few points."""
    parts = np.unique(ends, return_inverse=True)[1].reshape(-1, 2) // _TOGETHER
    _, block = np.unique(parts, axis=0, return_inverse=True)
    order = np.argsort(block.ravel(), kind="stable")
    return list(np.split(order, np.cumsum(np.bincount(block.ravel()))[:-1]))


def _weighed(E: Array, covariance: Array) -> Array:
    """Return E covariance (N, 3, k) for E (N, 3, k), as one product: N of them would read the covariance N times."""
    return np.asarray((E.reshape(3 * len(E), E.shape[2]) @ covariance).reshape(E.shape))
