"""What a set of cameras measures: every limit in every pose, with the contributions to its uncertainty."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Array, Brief
from cadcam.camera.error_source import ErrorSource, distinct_sources, index_of
from cadcam.camera.measurement import PIXELS
from cadcam.camera.viewpoint import Viewpoint
from cadcam.geometry.rigid import Rigid
from cadcam.plan.assessment.asked import Asked
from cadcam.plan.sight.candidate import Candidate
from cadcam.plan.sight.datum import alone_from_datum, together_from_datum
from cadcam.plan.sight.places import Places
from cadcam.plan.sight.visibility import Visibility
from cadcam.plan.uncertainty.evidence import Evidence, Together, symmetric, together
from cadcam.plan.uncertainty.predict import shifts, sources_of
from cadcam.verify.deviations.measured import UNSEEN_PX
from cadcam.verify.tolerances.tolerance import Limit, Rule
from cadcam.verify.tolerances.verdict import SIMPLE_SHARE

_AT_ONCE = 5_000_000  # numbers in the tables of shared errors, which grow with the square of the number of cameras
HEIGHT = "plane"


class Outcome(Enum):
    """What can be said of a limit with these cameras. The value is its word in reports."""

    SUITABLE = "SUITABLE"
    MARGINAL = "MARGINAL"
    UNSUITABLE = "UNSUITABLE"
    NOT_MEASURED = "NOT MEASURED"

    @property
    def rank(self) -> int:
        """Return how bad it is, 0 to 3."""
        return list(Outcome).index(self)


def outcome(ratio: float, limit: Limit, wanted: float) -> Outcome:
    """Return what a test uncertainty ratio means for a limit, by ISO 14253-1 as `cadcam verify` decides.

    With a guard band nothing can pass from U = limit on (ratio 1); below, parts within limit - U pass. Simple
    acceptance decides nothing where U is more than a third of the limit. SUITABLE: the ratio is as large as wanted.
    """
    if not ratio > 0:
        return Outcome.NOT_MEASURED
    least = 1 / SIMPLE_SHARE if limit.rule is Rule.SIMPLE else 1.0
    if ratio <= least * (1 if limit.rule is not Rule.SIMPLE else 1 - 1e-12):
        return Outcome.UNSUITABLE
    return Outcome.SUITABLE if ratio >= wanted else Outcome.MARGINAL


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Assessment(Brief):
    """Of L limits in P poses: sigma (P, L) mm or rad, NaN if not measured; its direction (P, L, 3) in part axes.

    ratio (P, L): limit/U, 0 if not measured. cameras (P, L): how many see the feature. shares: by cause, the share
    (P, L) of the variance along that direction.
    """

    asked: Asked
    sigma: Array
    direction: Array
    ratio: Array
    cameras: npt.NDArray[np.int64]
    shares: Mapping[str, Array]

    @property
    def worst_pose(self) -> npt.NDArray[np.int64]:
        """Return the pose (L,) in which each limit has its least ratio."""
        return np.asarray(self.ratio.argmin(axis=0))

    @property
    def worst(self) -> float:
        """Return the least ratio of all limits in all poses; 0 if one is not measured."""
        return float(self.ratio.min())

    def outcomes(self, wanted: float) -> list[Outcome]:
        """Return what can be said of each limit, in its worst pose."""
        least = self.ratio.min(axis=0)
        return [outcome(float(r), limit, wanted) for r, limit in zip(least, self.asked.limits, strict=True)]


def assess(
    chosen: Sequence[Candidate], visibility: Sequence[Visibility], places: Places, poses: Sequence[Rigid], asked: Asked
) -> Assessment:
    """Return what cameras measure together, given what each of them sees.

    Errors that cameras share, as those of one camera that is moved, are treated as shared.
    """
    P, L = len(poses), len(asked)
    viewpoints = [c.viewpoint for c in chosen]
    sources = sources_of(viewpoints)
    E, at = _shifts(viewpoints, sources, places, poses, asked)
    evidence = _of_limits(visibility, asked)
    prior = np.tile(asked.known, (P, 1, 1))
    parts = []
    step = max(1, _AT_ONCE // max(E.shape[-1], 1) ** 2)
    for first in range(0, P * L, step):
        part = slice(first, min(first + step, P * L))
        own = Evidence(evidence.J[:, part], evidence.W[:, part])
        parts.append(together(own, E[:, part], prior[part]))
    found = Together(*(np.concatenate([getattr(p, n) for p in parts]) for n in Together.__slots__))
    _judged(found, viewpoints, visibility, sources, at, asked)
    names = [s.name for s in sources]
    return _assessed(asked, found, names, at, _count(visibility, asked), P)


def _judged(
    found: Together,
    viewpoints: Sequence[Viewpoint],
    visibility: Sequence[Visibility],
    sources: Sequence[ErrorSource],
    at: Sequence[slice],
    asked: Asked,
) -> None:
    """Set what is found (P * L) of features that are judged relative to a datum."""
    own = np.flatnonzero(asked.relative >= 0)
    if not len(own):
        return
    evidence = [o.datum.of(asked.relative[own]) for o in visibility if o.datum is not None]
    every, columns = np.arange(found.by_number.shape[-1]), []
    for view in viewpoints:
        errs = distinct_sources([source for source, _ in view.errors])
        columns.append(np.concatenate([every[:0], *(every[at[index_of(sources, source)]] for source in errs)]))
    rows = (np.arange(0, len(found.covariance), len(asked))[:, None] + own).ravel()
    size = np.nanmean([o.mm_per_px[:, asked.feature[own]] for o in visibility], axis=0).ravel()
    expected = np.eye(3) / (UNSEEN_PX * size)[:, None, None] ** 2
    told = together_from_datum(evidence, columns, len(every), expected)
    for name in Together.__slots__:
        getattr(found, name)[rows] = getattr(told, name)


def _of_limits(visibility: Sequence[Visibility], asked: Asked) -> Evidence:
    """Return the evidence (V, P * L) of each camera for each limit."""
    turns = asked.turns[None, :, None, None]

    def part(name: str) -> Array:
        each = [
            np.where(turns, getattr(o.turns, name)[:, asked.feature], getattr(o.evidence, name)[:, asked.feature])
            for o in visibility
        ]
        stacked = np.stack(each)
        return stacked.reshape(len(visibility), -1, *stacked.shape[-2:])

    return Evidence(part("J"), part("W"))


def _shifts(
    viewpoints: Sequence[Viewpoint],
    sources: Sequence[ErrorSource],
    places: Places,
    poses: Sequence[Rigid],
    asked: Asked,
) -> tuple[Array, list[slice]]:
    """Return each picture's shift by errors of unit variance, (V, P * L, 2, n); for slopes, per mm of edge."""
    ends = places.ends[asked.feature]
    at_ends = []
    for k in range(2):
        p = np.where(asked.turns[:, None], ends[:, k], places.centre[asked.feature])
        world = np.concatenate([pose @ p for pose in poses])
        effects = [tuple(np.nan_to_num(D) for D in v.project(world)[2]) for v in viewpoints]
        E, at = shifts(viewpoints, effects, sources, len(world))
        at_ends.append(E)
    turns = np.tile(asked.turns, len(poses))[:, None, None]
    length = np.tile(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1), len(poses))[:, None, None]
    return np.where(turns, (at_ends[1] - at_ends[0]) / np.where(turns, length, 1.0), at_ends[0]), at


def informations(visibility: Sequence[Visibility], asked: Asked, *, cameras: int) -> Array:
    """Return the information (V, P, L, 3, 3) of each camera alone, which a search for so many cameras adds up."""
    evidence = _of_limits(visibility, asked)
    turns = asked.turns[:, None, None]
    shift = np.stack([np.where(turns, o.bend[:, asked.feature], o.shift[:, asked.feature]) for o in visibility])
    P, L = shift.shape[1:3]
    out = evidence.alone(shift.reshape(len(visibility), P * L, 2, 2)).reshape(len(visibility), P, L, 3, 3)
    own = asked.relative >= 0
    if own.any():
        told = alone_from_datum([o.datum for o in visibility if o.datum is not None], cameras)
        out[:, :, own] = told[:, :, asked.relative[own]]
    return out


def _count(visibility: Sequence[Visibility], asked: Asked) -> npt.NDArray[np.int64]:
    return np.asarray(np.sum([o.seen[:, asked.feature] for o in visibility], axis=0))


def _assessed(
    asked: Asked,
    found: Together,
    names: Sequence[str],
    at: Sequence[slice],
    cameras: npt.NDArray[np.int64],
    poses: int,
) -> Assessment:
    L = len(asked)
    sigma, worst = asked.worst(found.covariance.reshape(poses, L, 3, 3))
    direction = worst / np.maximum(np.linalg.norm(worst, axis=-1, keepdims=True), 1e-300)
    d = worst.reshape(-1, 3)
    variance = {PIXELS: np.einsum("ni,nij,nj->n", d, found.from_pixels, d)}
    for name, columns in zip(names, at, strict=True):
        more = np.sum(np.einsum("ni,nip->np", d, found.by_number[..., columns]) ** 2, axis=-1)
        variance[name] = variance.get(name, 0.0) + more
    known = symmetric(found.covariance @ np.tile(asked.prior, (poses, 1, 1)) @ found.covariance)
    if asked.prior.any():
        variance[HEIGHT] = np.einsum("ni,nij,nj->n", d, known, d)
    total = np.maximum(sigma.ravel() ** 2, 1e-300)
    shares = {name: np.nan_to_num(v / total).reshape(poses, L) for name, v in variance.items()}
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = np.nan_to_num(asked.value / (asked.k * sigma), nan=0.0)
    return Assessment(asked, sigma, direction, ratio, cameras, shares)
