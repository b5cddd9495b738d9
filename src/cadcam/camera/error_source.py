"""What errs: uncertain parameters, a calibration's or a motion's, that move all that is measured with them together."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from cadcam.arrays import Array, Brief, frozen
from cadcam.errors import BadValue


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class ErrorSource(Brief):
    """Uncertain parameters and their covariance (k, k); the same `owner` is the same source.

    owner: any object; what counts is that it is the same one, not that it is equal.
    dof: degrees of freedom behind the noise that scales the covariance; inf where it is known.
    """

    name: str
    covariance: Array
    owner: object = field(repr=False)
    dof: float = np.inf

    def __post_init__(self) -> None:
        covariance = frozen(self.covariance, f"covariance of {self.name}", (None, None))
        if covariance.shape[0] != covariance.shape[1]:
            raise BadValue(f"covariance of {self.name}", f"of shape {covariance.shape}", "a square matrix")
        object.__setattr__(self, "covariance", covariance)

    @property
    def root(self) -> Array:
        """Return B (k, k) with B B^T the covariance, which may be singular and of mixed units."""
        sd = np.sqrt(np.diag(self.covariance))
        scale = np.where(sd > 0, sd, 1.0)
        w, V = np.linalg.eigh(self.covariance / np.outer(scale, scale))
        return np.asarray(scale[:, None] * V * np.sqrt(np.maximum(w, 0.0)))


def distinct_sources(sources: Sequence[ErrorSource]) -> list[ErrorSource]:
    """Return the sources, each owner's once; `BadValue` where one owner has two covariances."""
    first = [index_of(sources, s) for s in sources]
    for one, other in zip((sources[k] for k in first), sources, strict=True):
        if one is not other and not np.array_equal(one.covariance, other.covariance):
            said = f"another than that of {other.name}, which has the same owner"
            raise BadValue(f"covariance of {one.name}", said, "one covariance for one owner, or owners of their own")
    return [s for i, s in enumerate(sources) if first[i] == i]


def covariance_of(effects: Iterable[tuple[ErrorSource, Array]], n: int) -> Array:
    """Return the covariance (n, n) of n numbers that sources move by E (n, k) each; effects of the same source add.

    Raises `BadValue` where one owner has two covariances.
    """
    every = list(effects)
    total = np.zeros((n, n))
    for source in distinct_sources([s for s, _ in every]):
        E = sum((own for s, own in every if s.owner is source.owner), np.zeros((n, len(source.covariance))))
        total += E @ source.covariance @ E.T
    return total


def by_unit_errors(
    effects: Iterable[tuple[ErrorSource, Array]], sources: Sequence[ErrorSource], shape: tuple[int, ...]
) -> tuple[Array, list[slice]]:
    """Return what effects D (..., k) of errors do to numbers of a shape, E (..., P), and each source's columns in it.

    The P columns belong to independent errors of unit variance; effects of the same source add.
    """
    starts = [0, *np.cumsum([len(s.covariance) for s in sources]).tolist()]
    columns = [slice(a, b) for a, b in pairwise(starts)]
    E = np.zeros((*shape, starts[-1]))
    for source, D in effects:
        E[..., columns[index_of(sources, source)]] += D @ source.root
    return E, columns


def index_of(sources: Sequence[ErrorSource], source: ErrorSource) -> int:
    """Return the first index of a source of the same owner."""
    return next(k for k, s in enumerate(sources) if s.owner is source.owner)
