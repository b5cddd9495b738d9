"""How well a peak of the correlation is known: from what the template does not explain, and the slopes on both sides.

A peak is where the template's slopes J by its motions are orthogonal to the residual r: J r = 0. So an error of the
motions is H^-1 J r, with H = J Jp^T, Jp the picture's slopes there, and the covariance H^-1 S H^-T, S that of J r.
Noise in the template's slopes adds to J J^T, which therefore says that more is known than is; noise of template and
picture have nothing to do with each other, so that H holds what both show.

S is not s^2 J J^T: rounding to eight bits leaves nothing where all is flat and most at edges, what an edge's pixels
leave unexplained is alike along it, and in an enlarged picture from pixel to pixel. So S is estimated as the squares of
what J r comes to in squares of pixels all over the template (W. Newey and K. West, A simple, positive semi-definite,
heteroskedasticity and autocorrelation consistent covariance matrix, 1987, in two dimensions).

Along an edge they show nothing but noise, which has peaks of its own, all along it: the slopes at the best of these
agree, as at any peak, and H says that it is known to half a pixel. So H counts only for motions that change what is
seen by clearly more than noise does, or from whose either side a climb returns to the peak. What is known of other
motions is the range in which they were looked for.

That range is hundreds of px, so that an error of an edge's direction, times it, would pass for one across the edge: by
the slopes alone ten times what is known there. So the edge is followed as far as it goes, to both sides, and its
direction is that of the line from end to end.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from cadcam.arrays import Array, Longs, Mask, Picture
from cadcam.native.correlate import Points, pulls

# Points by which the slopes are compared: what they say of both sides is a ratio of sums, known to a few hundredths by
# a thousand. Of more points, those a golden section of them apart, round and round: in no step with their rows.
_MOST, _APART = 1024, (np.sqrt(5.0) - 1) / 2
_LEAST = 1e-3  # of what the template's slopes say: below, the picture does not show a motion at all
# sd of what noise alone makes both show. At the highest of the peaks that it makes along an edge, of some hundred, it
# is 2, as noise falls off about a peak of 3 sd (1.9 +- 0.8 if it is as smooth as a Gaussian); 5 were seen.
_CLEARLY = 6.0
# Less, but as much as noise by itself, counts if climbs from so many px at the rim, where noise has other peaks, all
# end within a quarter of it.
_AT_LEAST, _AWAY = 1.0, (4.0, 8.0)
_FAIRLY, _NEAR = 3.0, (2.0,)  # what noise hardly reaches, from less far off: a thin line draws no climb from 4 px
_CLIMB = ((8, 0.8), (40, 0.25))  # after so many steps, what share of the way may be left
_HIGH = 0.98  # share of the best score from which peaks are looked into so: the first, and those that may be it
_BY_NOISE = 8.0  # sd, of white noise, of a share of a motion that the noise of smoothed slopes (twice that) may feign
_FIRST, _ROUNDS, _FEW = 0.5, 8, 4  # an edge is followed by half a rim at first, in so many rounds, by short climbs
_SQUARES = 3  # that tell of a motion, at least: what is not explained goes together within each of them
_EXACT = 1e-12  # of what the best motion shows (squared): less is rounding


# A climb to the peaks near poses, in at most so many steps, with so many motions free; and the scores there
Climb = Callable[[Array, int, int], tuple[Array, Array]]


def peak_covariances(
    picture: Picture, points: Points, poses: Array, score: Array, range_of: Array, climb: Climb
) -> Array:
    """Return the covariances (N, 4, 4) of x, y (px), angle (rad) and scale (0 where it was not free) of peaks.

    range_of (4,): over how many px, rad and shares of the scale they were looked for.
    """
    whole, motions = _slopes_of(points), len(points.slope)
    side = _together(whole.telling, motions)
    moments, both = pulls(picture, points, poses, side)
    moments /= max(1 - motions * side**2 / whole.telling, 0.25)  # as many pulls fewer than squares as are fitted
    high = np.abs(score) >= _HIGH * np.abs(score).max(initial=0.0)
    each = []
    for pose, moment, shown, worth, looked_into in zip(poses, moments, both, np.abs(score), high, strict=True):
        slopes, per_motion = whole, _per_motion(pose, motions)
        clear = _clear(picture, slopes, pose, _MOST)
        weak = clear <= _CLEARLY
        if np.count_nonzero(weak) > 1:
            slopes = slopes.apart(weak, per_motion, range_of)
        if looked_into and weak.any():
            clear = _clear(picture, slopes, pose, points.count)
        elif slopes is not whole:
            clear = _clear(picture, slopes, pose, _MOST)
        known = clear > _CLEARLY
        if looked_into:
            known |= _returned_to(slopes, pose, clear, range_of, climb)
        left_open = (per_motion @ _plain(slopes, ~known)).T
        if looked_into and not known.all():
            left_open = _followed(left_open, pose, _HIGH * worth, _FIRST * slopes.rim * pose[3], climb)
        each.append(_of_known(per_motion, slopes.motions[:, known], shown, moment) + _anywhere(left_open, range_of))
    return np.array(each).reshape(-1, 4, 4)


@dataclass(frozen=True, slots=True)
class _Slopes:
    """A template's points, all in float64, and their slopes (m, N) by motions of which none shows what another does.

    motions (m, m): these, in columns, from the least to the most that is shown by as many px at the rim; so long that
    what each shows has unit norm. rim (px): mean distance of the points from the centre.
    """

    u: Array
    v: Array
    value: Array
    slope: Array
    motions: Array
    length: Array
    rim: float

    @classmethod
    def of(cls, points: Points) -> _Slopes:
        n = points.count
        u, v, value = (a[:n].astype(np.float64) for a in (points.u, points.v, points.value))
        J = points.slope[:, :n].astype(np.float64)
        rim = math.sqrt(float(np.mean(u**2 + v**2)))
        per_px = np.array([1.0, 1.0, 1 / rim, 1 / rim])[: len(J)]
        shown, motion = np.linalg.eigh(per_px[:, None] * (J @ J.T) * per_px)
        motions = per_px[:, None] * motion / np.sqrt(np.maximum(shown, _EXACT * shown[-1]))
        return cls(u, v, value, motions.T @ J, motions, np.linalg.norm(J, axis=1), rim)

    @property
    def telling(self) -> float:
        """Return how many points tell of the motions: along an edge, those on it."""
        told = np.sum(self.slope**2, axis=0)
        return float(np.sum(told) ** 2 / np.sum(told**2))

    @property
    def px(self) -> Array:
        """Return by how many px at the rim each motion (m,) moves."""
        per_px = np.array([1.0, 1.0, self.rim, self.rim])[: len(self.motions)]
        return np.asarray(np.linalg.norm(per_px[:, None] * self.motions, axis=0))

    def apart(self, weak: Mask, per_motion: Array, range_of: Array) -> _Slopes:
        """Return them with those motions that show little told apart by how far they move the rim in the range.

        Noise mixes them: of an edge of any scale, the shift along it with the growth. The furthest comes first.
        """
        ranged = per_motion @ self.motions[:, weak] / range_of[:, None]
        U, _, _ = np.linalg.svd(ranged, full_matrices=False)
        px = range_of * np.array([1.0, 1.0, self.rim, self.rim])
        _, _, Vt = np.linalg.svd(px[:, None] * U)
        mixed, _ = np.linalg.qr(np.linalg.pinv(ranged) @ U @ Vt.T)
        motions, slope = self.motions.copy(), self.slope.copy()
        motions[:, weak], slope[weak] = motions[:, weak] @ mixed, mixed.T @ slope[weak]
        return replace(self, motions=motions, slope=slope)


@lru_cache(maxsize=4)  # of the templates last searched for
def _slopes_of(points: Points) -> _Slopes:
    return _Slopes.of(points)


def _clear(picture: Picture, slopes: _Slopes, pose: Array, most: int) -> Array:
    """Return how many sd of noise (m,) the template and the picture both show of each motion of the slopes."""
    shown, by_noise = _compared(picture, slopes, pose, _spread(len(slopes.u), most))
    clear = np.full(len(shown), np.inf)
    np.divide(shown, by_noise, out=clear, where=by_noise > 0)
    return np.where(shown > 0, clear, 0.0)


def _returned_to(slopes: _Slopes, pose: Array, clear: Array, range_of: Array, climb: Climb) -> Mask:
    """Return which motions (m,) that do not show clearly lead back to a peak by climbs from either side."""
    motions = len(clear)
    along = (_per_motion(pose, motions) @ (slopes.motions / slopes.px)).T  # (m, 4), of a px at the rim
    most = 0.5 / np.linalg.norm(along / range_of, axis=1)
    asked = np.flatnonzero((clear > _AT_LEAST) & (clear <= _CLEARLY))
    tried = [(i, sign * far) for i in asked for far in (_NEAR if clear[i] > _FAIRLY else _AWAY) for sign in (-1, 1)]
    back = np.isin(np.arange(motions), asked)
    if not tried:
        return back
    motion, away = (np.array(column) for column in zip(*tried, strict=True))
    away = np.clip(away, -most[motion], most[motion])
    there = pose + away[:, None] * along[motion]
    px = np.array([1.0, 1.0, pose[3] * slopes.rim, slopes.rim])
    for steps, share in _CLIMB:
        left = back[motion]
        motion, away, there = motion[left], away[left], climb(there[left], steps, motions)[0]
        off = there - pose
        off[:, 2] = (off[:, 2] + math.pi) % (2 * math.pi) - math.pi
        back[motion[~(np.linalg.norm(off * px, axis=1) < share * pose[3] * np.abs(away))]] = False
    return back


def _of_known(per_motion: Array, motions: Array, H: Array, moment: Array) -> Array:
    """Return the covariance (4, 4) of a peak's known motions (m, k): where the template does not move by others."""
    U, shown, Vt = np.linalg.svd(motions.T @ H @ motions)
    error = per_motion @ motions @ (Vt.T / np.maximum(shown, _LEAST)) @ U.T @ motions.T
    return np.asarray(error @ moment @ error.T)


def _together(telling: float, motions: int) -> int:
    """Return the side in px, a power of two, of the squares of which a template has enough to tell how they vary."""
    return 1 << int(math.log2(max(1.0, math.sqrt(telling / (_SQUARES * motions)))))


def _anywhere(left_open: Array, range_of: Array) -> Array:
    """Return the covariance (4, 4) of what may be anywhere in the range, by motions (k, 4) that do not show."""
    ranged = left_open / range_of
    return np.asarray(left_open.T @ np.linalg.pinv(12 * ranged @ ranged.T, hermitian=True) @ left_open)


def _followed(left_open: Array, pose: Array, least: float, first: float, climb: Climb) -> Array:
    """Return what is left open with the direction of shifts measured: by places on both sides of at least a score.

    first: px to the first of these; twice as far each time, and half as far again where there is none.
    """
    followed = left_open.copy()
    for i, motion in enumerate(left_open):
        length = float(np.linalg.norm(motion))
        if length == 0 or motion[2:].any():
            continue
        along, far, ends = motion / length, np.array([-first, first]), np.stack([pose, pose])
        for _ in range(_ROUNDS):
            there, score = climb(ends + far[:, None] * along, _FEW, 3)
            went = (there - ends)[:, :2] @ along[:2] / far
            on = (np.abs(score) >= least) & (went > 0.5) & (went < 2)
            ends[on] = there[on]
            far *= np.where(on, 2.0, 0.5)
            if on.any():
                line = ends[1, :2] - ends[0, :2]
                along[:2] = line / np.linalg.norm(line)
        followed[i] = length * along
    return followed


def _compared(picture: Picture, slopes: _Slopes, pose: Array, some: Longs) -> tuple[Array, Array]:
    """Return the diagonal of J Jp^T by some of the points, and the sd that noise alone gives each number of it.

    Noise has at most the variance in central differences that it has itself. A motion's slope is that by the px by
    which it moves a point.
    """
    share = len(slopes.u) / len(some)
    u, v, J = slopes.u[some], slopes.v[some], slopes.slope[:, some]
    H, residual = _in_common(picture, u, v, slopes.value[some], J, pose)
    shift, (turn, grow) = slopes.motions[:2, :, None], (*slopes.motions[2:, :, None], 0.0)[:2]
    moved = (shift[0] - turn * v + grow * u) ** 2 + (shift[1] + turn * u + grow * v) ** 2
    variance = (pose[3] * share) ** 2 * np.sum(J**2 * moved * residual**2, axis=1)
    return share * np.einsum("ij,ji->i", H, slopes.motions), np.sqrt(variance)


def _plain(slopes: _Slopes, which: Mask) -> Array:
    """Return motions (m, k) that do not show, without shift, turn or growth that they hold only by noise."""
    shows = np.abs(slopes.motions[:, which]) * slopes.length[:, None]
    shows[:2] = np.hypot(*shows[:2])
    held = shows >= np.minimum(_BY_NOISE / math.sqrt(len(slopes.u)), 0.5 * shows.max(axis=0, initial=0.0))
    return np.asarray(np.where(held, slopes.motions[:, which], 0.0))


def _spread(count: int, most: int) -> Longs:
    """Return the numbers of at most so many points of all, spread over them."""
    if count <= most:
        return np.arange(count)
    return np.asarray(np.arange(most) * _APART % 1.0 * count, np.int64)


def _per_motion(pose: Array, motions: int) -> Array:
    """Return the derivatives (4, m) of x, y, angle and scale by shifts along the template's axes, turn and size."""
    c, s = pose[3] * math.cos(pose[2]), pose[3] * math.sin(pose[2])
    return np.array([[c, -s, 0, 0], [s, c, 0, 0], [0, 0, 1, 0], [0, 0, 0, pose[3]]])[:, :motions]


def _in_common(picture: Picture, u: Array, v: Array, value: Array, slope: Array, pose: Array) -> tuple[Array, Array]:
    """Return J Jp^T (m, m) of points, and what is not explained of each (N,), both in grey levels of the template."""
    c, s = pose[3] * math.cos(pose[2]), pose[3] * math.sin(pose[2])
    x, y = pose[0] + c * u - s * v, pose[1] + s * u + c * v
    left, top = (max(math.floor(a.min()) - 2, 0) for a in (x, y))
    crop = picture[top : math.ceil(y.max()) + 3, left : math.ceil(x.max()) + 3]
    if min(crop.shape) < 2:
        return np.zeros((len(slope), len(slope))), np.zeros(len(u))
    seen, right, down = _between((crop, *_slopes(crop)), x - left, y - top)
    gu, gv = c * right + s * down, c * down - s * right
    gain = float(value @ (seen - seen.mean())) / max(float(value @ value), 1e-12)
    gain = gain if abs(gain) > 1e-12 else 1e-12
    shown = np.stack([gu, gv, gv * u - gu * v, gu * u + gv * v][: len(slope)])
    return np.asarray(slope @ shown.T / gain), (seen - seen.mean()) / gain - value + value.mean()


def _slopes(crop: Picture) -> tuple[Picture, Picture]:
    """Return the central differences (H, W) by x and y; none at the outline."""
    right, down = np.zeros_like(crop), np.zeros_like(crop)
    right[:, 1:-1] = 0.5 * (crop[:, 2:] - crop[:, :-2])
    down[1:-1] = 0.5 * (crop[2:] - crop[:-2])
    return right, down


def _between(planes: tuple[Picture, ...], x: Array, y: Array) -> list[Array]:
    """Return each plane (H, W) at points, bilinearly; beyond the outline as on it."""
    height, width = planes[0].shape
    x, y = np.clip(x, 0, width - 1), np.clip(y, 0, height - 1)
    i, j = np.minimum(x.astype(np.intp), width - 2), np.minimum(y.astype(np.intp), height - 2)
    a, b, at = x - i, y - j, j * width + i
    corners = ((at, (1 - a) * (1 - b)), (at + 1, a * (1 - b)), (at + width, (1 - a) * b), (at + width + 1, a * b))
    return [np.asarray(sum(weight * plane.ravel().take(k) for k, weight in corners)) for plane in planes]
