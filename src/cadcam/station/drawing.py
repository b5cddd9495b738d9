"""Measured marks compared with the CAD model: distances, angles, and the trend of all differences (Table 6.12)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np

from cadcam.arrays import Array, Floats, frozen
from cadcam.camera.measurement import Measurement
from cadcam.errors import BadValue, TooFewPoints, UnknownName

_LEVEL = 0.01  # probability below which a mean or a slope is not chance


@dataclass(frozen=True, slots=True)
class DistanceCheck:
    """Two marks: measured and drawn distance, mm; half the measured one's 95 % interval; the angle between them, rad.

    angle: of the measured line relative to the drawn one, counter-clockwise. sigma: of the distance, mm.
    """

    one: str
    other: str
    measured: float
    sigma: float
    half_width: float
    drawn: float
    angle: float

    @property
    def difference(self) -> float:
        """Return drawn minus measured, mm, as the thesis has it."""
        return self.drawn - self.measured


@dataclass(frozen=True, slots=True)
class DifferenceTrend:
    """Statistics of n differences, mm: mean, standard deviation, mean of the absolute values, and tests.

    slope: difference by length, mm per m, with its standard deviation; correlation: of difference and length. p_mean,
    p_slope: probability of such a mean, and of such a slope, if the differences were random about zero (Student, n - 1
    and n - 2 degrees of freedom: of few differences, a slope of many standard deviations is no surprise).
    """

    n: int
    mean: float
    sd: float
    mean_abs: float
    p_mean: float
    slope: float
    slope_sigma: float
    correlation: float
    p_slope: float

    @property
    def standard_error(self) -> float:
        """Return the standard deviation of the mean, mm."""
        return self.sd / float(np.sqrt(self.n))

    @property
    def t(self) -> float:
        """Return the mean in units of its standard deviation."""
        return _in_sigmas(self.mean, self.standard_error)

    @property
    def verdict(self) -> str:
        """Return in words what is significant at 1 %: a constant offset, a scale, both or neither."""
        scale, offset = self.p_slope < _LEVEL, self.p_mean < _LEVEL
        if offset and scale:
            return "the differences have an offset and grow with the length"
        if offset:
            return "a constant offset: the mean is not chance, and does not grow with the length"
        return "a scale: the differences grow with the length" if scale else "nothing but chance"


def check_distances(
    measured: Measurement, drawn: Mapping[str, Floats], pairs: Sequence[tuple[str, str]] | None = None
) -> tuple[DistanceCheck, ...]:
    """Return for each pair of marks (default: all) how their distance and direction compare with the drawing.

    drawn: places (2,) or (3,) mm by name, of which x and y count. Raises `UnknownName`.
    """
    names = [n for n in measured.names if n in drawn]
    for pair in pairs or ():
        for name in pair:
            if name not in drawn:
                raise UnknownName("mark of the drawing", name, drawn)
    chosen = list(combinations(names, 2)) if pairs is None else list(pairs)
    if not chosen:
        raise TooFewPoints("distances in the drawing", len(names), 2, of="marks")
    lengths = measured.distances(chosen)
    seen = _differences(dict(zip(measured.names, measured.points, strict=True)), chosen)
    on_drawing = _differences(drawn, chosen)
    drawn_lengths = np.linalg.norm(on_drawing, axis=1)
    if not drawn_lengths.all():
        one, other = chosen[int(np.argmin(drawn_lengths))]
        raise BadValue(f"distance of {one!r} and {other!r} on the drawing", 0, "two marks at different places")
    cross = on_drawing[:, 0] * seen[:, 1] - on_drawing[:, 1] * seen[:, 0]
    angles = np.arctan2(cross, np.sum(on_drawing * seen, axis=1))
    return tuple(
        DistanceCheck(one, other, length.value, length.sigma, length.half_width, on_it, angle)
        for (one, other), length, on_it, angle in zip(
            chosen, lengths, drawn_lengths.tolist(), angles.tolist(), strict=True
        )
    )


def independent(checks: Sequence[DistanceCheck]) -> tuple[DistanceCheck, ...]:
    """Return checks that share no mark, long ones first, so that `trend` may treat them as independent."""
    used: set[str] = set()
    out = []
    for check in sorted(checks, key=lambda c: -c.drawn):
        if not {check.one, check.other} & used:
            used |= {check.one, check.other}
            out.append(check)
    return tuple(out)


def trend(differences: Floats, lengths: Floats) -> DifferenceTrend:
    """Return the statistics of differences (n,) mm of distances of these lengths (n,) mm.

    They have to be independent: no mark in two of them (`independent`). Raises `TooFewPoints` below three.
    """
    from scipy.special import stdtr

    d = frozen(differences, "differences", (None,))
    L = frozen(lengths, "lengths", (len(d),))
    if len(d) < 3:
        raise TooFewPoints("a trend", len(d), 3, of="distances")
    mean, sd = float(d.mean()), float(d.std(ddof=1))
    slope, slope_sigma, r = _line(d, L / 1000)
    p_mean, p_slope = (
        2 * float(stdtr(len(d) - fitted, -abs(_in_sigmas(value, sigma))))
        for fitted, value, sigma in ((1, mean, sd / np.sqrt(len(d))), (2, slope, slope_sigma))
    )
    return DifferenceTrend(len(d), mean, sd, float(np.abs(d).mean()), p_mean, slope, slope_sigma, r, p_slope)


def trend_of_log(log: Sequence[Mapping[str, Any]], drawn: Mapping[str, Floats]) -> DifferenceTrend | None:
    """Return the statistics of distances between marks of one block in a station's log; None for less than three.

    Of each mark its latest measurement counts, and those that the drawing does not have do not. Long distances come
    first, and no mark is in two of them, so that they are independent. drawn: as in `check_distances`.
    """
    flat = {name: np.asarray(p, dtype=np.float64)[:2] for name, p in drawn.items()}
    latest = {(e.get("block", ""), e["mark"]): np.asarray(e["point_mm"])[:2] for e in log if e["mark"] in drawn}
    pairs = [(a, b) for a, b in combinations(latest, 2) if a[0] == b[0]]
    lengths = [float(np.linalg.norm(flat[b[1]] - flat[a[1]])) for a, b in pairs]
    used: set[tuple[str, str]] = set()
    chosen = []
    for i in sorted(range(len(pairs)), key=lambda i: -lengths[i]):
        if not set(pairs[i]) & used:
            used |= set(pairs[i])
            chosen.append(i)
    seen = [float(np.linalg.norm(latest[b] - latest[a])) for a, b in pairs]
    if len(chosen) < 3:
        return None
    return trend([lengths[i] - seen[i] for i in chosen], [lengths[i] for i in chosen])


def _differences(places: Mapping[str, Floats], pairs: Sequence[tuple[str, str]]) -> Array:
    """Return second less first place, x and y (n, 2), of n pairs of marks."""
    used = {name: i for i, name in enumerate(dict.fromkeys(name for pair in pairs for name in pair))}
    at = np.stack([np.asarray(places[name], dtype=np.float64)[:2] for name in used])
    ends = np.array([[used[one], used[other]] for one, other in pairs])
    return np.asarray(at[ends[:, 1]] - at[ends[:, 0]])


def _in_sigmas(value: float, sigma: float) -> float:
    """Return a value in units of its standard deviation: 0 for 0, even where nothing scatters."""
    return value / sigma if sigma > 0 else float(np.copysign(np.inf, value)) if value else 0.0


def _line(d: Array, x: Array) -> tuple[float, float, float]:
    """Return slope, its standard deviation, and the correlation; zeros where all lengths are the same."""
    about = x - x.mean()
    spread = float(about @ about)
    if spread == 0:
        return 0.0, 0.0, 0.0
    slope = float(about @ d) / spread
    left = d - d.mean() - slope * about
    scatter = float(np.sum((d - d.mean()) ** 2))
    r = slope * np.sqrt(spread / scatter) if scatter > 0 else 0.0
    return slope, float(np.sqrt(left @ left / (len(d) - 2) / spread)), float(r)
