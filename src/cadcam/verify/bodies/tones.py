"""How bright a photo is where a body ought to be: as the body would be in this light, or as what it would hide.

The pixels of the body's picture are grouped by what they show with the body and without it. The light, fitted to the
rest of the photo (`cadcam.locate.quality.light`), predicts the brightness of each of these surfaces and its
uncertainty; pieces of one surface have correlated errors. In either case the light may differ from the fitted one,
because of a shadow for instance, with a probability that no surface can outweigh: then the tones are any that the photo
has elsewhere, and edges that ought to be seen need not be; edges seen where none ought to be may then also belong to
what the body hides, as both lie in one shadow. Or the body has another paint than in the CAD. What lies in a cavity
may be dark, all of it as dark as the rest (`cadcam.verify.bodies.openness`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from cadcam.arrays import Array, Ids, Longs, Mask
from cadcam.geometry.rigid import Rigid
from cadcam.image.profile import noise_of
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.locate.quality.light import FittedLight, surfaces
from cadcam.verify.bodies.openness import CAVE, Sky, dimming
from cadcam.verify.edges.shown import ShownFaces, in_window, window_around

_RIM_PX = 3  # margin of the body's picture, which is blurred, or another body's if that one is off
_LEAST_PX = 60  # least size of a piece that counts: small ones are borders and corners
_LAPSE = 0.02  # probability that the light differs from the fitted one
_ONE_SHADOW = 0.05  # share of these cases in which a body looks like what it hides
_UNEVEN = 0.006  # sd of brightness between pieces of one surface
_BESIDE_PX = 14  # range beside a body, and inside it, in which what it hides is compared with it
_ANY_MEAN, _ANY_SPREAD = 0.5, 0.3  # prior brightness of what is no part, and of the light as a whole
_ONE_SURFACE = 0.995  # cosine between normals of one surface
_ROUND_SHARE = 0.25  # share of narrow strips in the picture of a round body: flat ones have a tenth
_ROUND_STEPS = 1.0  # quantisation of normals, steps per unit, within which the strips of a round surface are one piece


@dataclass(frozen=True, slots=True, eq=False)
class _SurfacePixels:
    """Some pixels: normal (n, 3) and colour (n,) of what they show, and the number (n,) of that surface.

    q (n, 2) px: their places in the photo; sky: over the part as it shows in them.
    """

    normal: Array
    color: Ids
    surface: Longs
    q: Array
    sky: Sky

    @classmethod
    def of(cls, shown: ShownFaces, where: Mask, corner: Array, sky: Sky) -> _SurfacePixels:
        """Return the pixels `where` (h, w) of a window whose left top `corner` is (2,) px."""
        face, q = shown.face[where], np.argwhere(where)[:, ::-1] + corner
        return cls(shown.normal[face], shown.color[face], shown.surface[face], q, sky)

    def log_density(self, light: FittedLight, tones: Array, pieces: Sequence[Longs]) -> float:
        """Return the log probability density of tones (r,), each the mean of a piece: a subset of the n pixels."""
        if not len(pieces):
            return 0.0
        at = np.concatenate(pieces)
        _, first, kind = np.unique(self.surface[at], return_index=True, return_inverse=True)
        of = np.repeat(np.arange(len(pieces)), [len(piece) for piece in pieces])
        share = np.zeros((len(pieces), len(first)))
        np.add.at(share, (of, kind.reshape(-1)), 1.0)
        share /= share.sum(axis=1, keepdims=True)
        each, V, open_ = self._brightness(light, at, first, kind.reshape(-1))
        mean = share @ each
        turned = np.maximum(share @ each**2 - mean**2, 0.0)  # a round piece has no single brightness
        mostly = np.argmax(share, axis=1)  # pieces of one surface are correlated, as are the strips of a round one
        told = _log_normal(tones - mean, V[np.ix_(mostly, mostly)] + np.diag(_UNEVEN**2 + turned))
        if (open_[mostly] >= CAVE).any():
            return told
        # Or all of a cavity is as dark as the rest of it, and looks like one surface before it.
        one = np.full((len(mean), len(mean)), np.diag(V)[mostly].mean())
        alike = _log_normal(tones - mean.mean(), one + _UNEVEN**2 * np.eye(len(mean)))
        return float(np.logaddexp(told, alike) - np.log(2))

    def in_any_paint(self, light: FittedLight, tones: Array, pieces: Sequence[Longs]) -> float:
        """Return the log probability density of tones (r,) if each surface may have any, all its pieces the same."""
        surface = np.array([self.surface[piece[0]] for piece in pieces])  # of a round body's strips, one of several
        V = np.where(surface[:, None] == surface, light.spread**2 + _ANY_SPREAD**2, 0.0)
        return _log_normal(tones - light.mean, V + _UNEVEN**2 * np.eye(len(tones)))

    def _brightness(self, light: FittedLight, at: Longs, first: Longs, kind: Longs) -> tuple[Array, Array, Array]:
        """Return the brightness (r,) predicted of the surfaces of pixels `at` (m,), its covariance, and openness.

        first (r,): one of these of each surface; kind (m,): the surface of each; covariance (r, r); openness (r,).
        """
        normal, color = self.normal[at[first]], self.color[at[first]]
        mean, V = light.brightness_and_covariance(normal, color)
        nothing = color < 0
        open_ = self.sky.of_groups(self.q[at], np.where(nothing[kind], -1, kind), len(first))
        kept, variance = dimming(mean, open_)
        mean, V = mean * kept, V * np.outer(kept, kept) + np.diag(variance)
        mean[nothing], V[nothing], V[:, nothing] = _ANY_MEAN, 0.0, 0.0
        V[nothing, nothing] = _ANY_SPREAD**2
        return mean, V, open_


@dataclass(frozen=True)
class Tones:
    """A part at a pose in photos: the evidence of brightness for each of its bodies; shown: what each photo shows."""

    part: Part
    photos: Sequence[Photo]
    world_from_part: Rigid
    shown: Sequence[ShownFaces]

    def log_ratio(self, body: int, *, edges: float = 0.0, any_light: float = 0.0) -> float:
        """Return the log likelihood ratio of "present" to "absent" of part number `body`.

        edges: that of its edges, which assumes the same light for edges that are not seen; any_light: that of its edges
        if nothing is known of the light: if it favours the body, this may look like what it hides in spite of the
        fitted light.
        """
        densities = [self._in_photo(photo, shown, body) for photo, shown in zip(self.photos, self.shown, strict=True)]
        there, not_there, other, painted = np.sum(densities, axis=0)
        if not np.any(densities):
            return edges
        lapsed = max(edges, 0.0) + float(np.logaddexp(other, painted) - np.log(2))
        if any_light > 0:
            dim = np.logaddexp(np.log1p(-_ONE_SHADOW) + other, np.log(_ONE_SHADOW) + not_there)
            lapsed = max(edges, any_light) + float(dim)
        return _lapsing(edges + there, lapsed) - _lapsing(not_there, other)

    def _in_photo(self, photo: Photo, whole: ShownFaces, body: int) -> tuple[float, float, float, float]:
        """Return the log densities of the tones with the body, without it, under any other light, and in other paint.

        All are 0 where the photo shows too little of the body to be evidence.
        """
        covered = _Covered.of(self.part, photo, self.world_from_part, whole, body)
        if covered is None:
            return 0.0, 0.0, 0.0, 0.0
        own, behind = covered.surfaces()
        pieces = _pieces(own, behind)
        if not pieces:
            return 0.0, 0.0, 0.0, 0.0
        light = whole.light(photo, without=whole.shows(body))
        gray = covered.gray[covered.inside]
        tones = np.array([np.median(gray[piece]) for piece in pieces])
        other = _log_normal(tones - light.mean, light.spread**2 * np.eye(len(tones)) + _ANY_SPREAD**2)
        # Without the body, a piece is as bright as the same surface is beside it; else as the light predicts.
        noise = noise_of(photo.gray)
        near = np.array([covered.from_beside(piece, noise) for piece in pieces])
        known = np.isfinite(near[:, 0])
        rest = [p for p, beside in zip(pieces, known, strict=True) if not beside]
        not_there = behind.log_density(light, tones[~known], rest)
        not_there += _log_normal(near[known, 0], np.diag(near[known, 1] ** 2))
        return own.log_density(light, tones, pieces), not_there, other, own.in_any_paint(light, tones, pieces)


@dataclass(frozen=True, slots=True, eq=False)
class _Covered:
    """The window of a photo around a body's picture, with what the part shows there with the body and without it.

    gray (h, w); shown, hidden: with the body, and without it; its, inside (h, w): the pixels of the body, and those of
    them that are not near its border; corner (2,) px: the window's left top; behind: the sky without the body.
    """

    gray: Array
    shown: ShownFaces
    hidden: ShownFaces
    its: Mask
    inside: Mask
    corner: Array
    behind: Sky

    @classmethod
    def of(cls, part: Part, photo: Photo, world_from_part: Rigid, whole: ShownFaces, body: int) -> _Covered | None:
        """Return the window of a body, None where too little of it is seen; whole: what the part shows in the photo."""
        from scipy.ndimage import binary_erosion

        window = whole.window(body, _BESIDE_PX + 4 * _RIM_PX)
        if window is None:
            return None
        shown = replace(whole, face=whole.face[window])
        its = shown.shows(body)
        inside = binary_erosion(its, iterations=_RIM_PX)
        if inside.sum() < _LEAST_PX:
            return None
        hidden = ShownFaces.of(part, photo, world_from_part, without=body, window=window)
        corner = np.array(in_window(window)[:2], np.float64)
        behind = replace(Sky.of(part, photo, world_from_part, window), without=body)
        return cls(photo.gray[window].astype(np.float64), shown, hidden, its, inside, corner, behind)

    def surfaces(self) -> tuple[_SurfacePixels, _SurfacePixels]:
        """Return what the n pixels inside of the body show, and what they would show without it."""
        own = _SurfacePixels.of(self.shown, self.inside, self.corner, replace(self.behind, without=-1))
        return own, _SurfacePixels.of(self.hidden, self.inside, self.corner, self.behind)

    def from_beside(self, numbers: Longs, noise: float) -> tuple[float, float]:
        """Return how much brighter a piece is than what it would hide is beside it, and how uneven that is.

        numbers: of the piece's pixels among those inside; noise: of a pixel. nan where too little of the surface that
        it would hide is visible beside it.
        """
        from scipy.ndimage import binary_dilation, distance_transform_edt

        shown, hidden, piece = self.shown, self.hidden, _where(self.inside, numbers)
        window = window_around(piece, _BESIDE_PX + 2 * _RIM_PX)
        piece, gray, its = piece[window], self.gray[window], self.its[window]
        there = hidden.face[window]
        here = int(there[piece][0])
        alike = (hidden.part == hidden.part[here]) & (hidden.color == hidden.color[here])
        same = (alike & (hidden.normal @ hidden.normal[here] > _ONE_SURFACE))[there]
        in_sight = shown.part[shown.face[window]] == hidden.part[there]
        beside = same & in_sight & ~binary_dilation(its, iterations=_RIM_PX)
        beside &= distance_transform_edt(~piece) <= _BESIDE_PX + 2 * _RIM_PX
        if hidden.part[here] < 0 or beside.sum() < _LEAST_PX:
            return np.nan, np.nan
        own = piece & (distance_transform_edt(~beside) <= _BESIDE_PX + 2 * _RIM_PX)
        if own.sum() < _LEAST_PX:
            return np.nan, np.nan
        level, uneven = _level(gray[beside])
        tone, uneven_too = _level(gray[own])
        return tone - level, float(np.sqrt(_UNEVEN**2 + max(uneven**2 + uneven_too**2 - 2 * noise**2, 0.0)))


def _pieces(own: _SurfacePixels, behind: _SurfacePixels) -> list[Longs]:
    """Return the pixels of each piece: one surface in front of one other; of a round body, narrow strips together.

    The narrow pieces of a mostly flat body are its borders and corners, which are no evidence.
    """
    pairs = _pairs(own.surface, behind.surface)
    large = np.bincount(pairs)[pairs] >= _LEAST_PX
    out = [np.flatnonzero(pairs == i) for i in np.unique(pairs[large])]
    rest = np.flatnonzero(~large)
    if len(rest) < _ROUND_SHARE * len(pairs):
        return out
    strips = _pairs(surfaces(own.normal[rest], own.color[rest], steps=_ROUND_STEPS), behind.surface[rest])
    return out + [rest[strips == i] for i in np.flatnonzero(np.bincount(strips) >= _LEAST_PX)]


def _where(inside: Mask, piece: Longs) -> Mask:
    """Return the pixels (h, w) that are a piece of those inside."""
    out = np.zeros(inside.shape, bool)
    out.ravel()[np.flatnonzero(inside)[piece]] = True
    return out


def _level(gray: Array) -> tuple[float, float]:
    """Return the median of brightnesses and their robust standard deviation."""
    level = float(np.median(gray))
    return level, 1.4826 * float(np.median(np.abs(gray - level)))


def _pairs(one: Longs, other: Longs) -> Longs:
    """Return the number (n,) of each pair of numbers (n,), from 0."""
    numbers, at = np.unique(other, return_inverse=True)
    return np.asarray(np.unique(one * len(numbers) + at, return_inverse=True)[1], np.int64)


def _lapsing(as_told: float, other: float) -> float:
    """Return the log density under the fitted light, but for a lapse."""
    return float(np.logaddexp(np.log1p(-_LAPSE) + as_told, np.log(_LAPSE) + other))


def _log_normal(r: Array, V: Array) -> float:
    """Return the log density of r (n,), normally distributed about 0 with covariance V (n, n)."""
    if not len(r):
        return 0.0
    return float(-0.5 * (r @ np.linalg.solve(V, r) + np.linalg.slogdet(2 * np.pi * V)[1]))
