"""The likelihood of photos given the part with its bodies in some places, by how bright its surfaces then are.

Edges alone are mistaken for each other where a displacement brings one near another's place. The surfaces between them
are not: a wrong guess leaves strips of a wrong tone beside every edge. Places of a body are compared over all pixels
that it covers in any of them. The errors of a surface's pixels are correlated through the uncertainty of the light:
each surface has a tone of its own, about as bright as the light predicts, with a small gradient. So a guess is not
preferred for placing a surface where a tone that is wrong for all of it would be less so. Neighbouring pixels are
correlated as well, and some are outliers: squared residuals are bounded, and each counts as a fraction of an
observation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from cadcam.arrays import Array, Ids, Longs, Mask, Picture
from cadcam.geometry.rigid import Rigid
from cadcam.image.profile import BRIGHT, noise_of
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.locate.quality.light import FittedLight
from cadcam.verify.bodies.openness import CAVE, Sky, dimming
from cadcam.verify.edges.shown import ShownFaces, Window, in_window

_RIM_PX = 4  # px around a body's picture that are included
_BLUR_PX, _BLURRED_PX = 0.7, 3  # approximate blur of the photo; its extent
_WORST = 9.0  # bound of a pixel's squared residual, sigmas^2
_TOGETHER = 12.0  # correlated pixels that count as one observation
_OWN_PX = 3 * _TOGETHER  # least size of a surface with a tone of its own: that and its two gradients
_FALL = 5e-4  # sd of the gradient of brightness along a surface, per px
_ROUNDS = 3
_MOST_PATCHES = 200  # with a tone of their own
_UNEVEN = 0.006  # sd of brightness between patches of one surface


def log_likelihoods(
    photos: Sequence[Photo], world_from_part: Rigid, guesses: Sequence[Part], body: int, shown: Sequence[ShownFaces]
) -> tuple[Array, float, float]:
    """Return the log likelihoods (k,) of the photos wherever any of the guesses has a body, and two more.

    Without the body, and with something else before where the first guess has it: one surface of any tone. Up to a
    common constant. guesses: the part, drawn with that body in several places; shown: what the first of them
    shows in each photo.
    """
    scores = np.zeros(len(guesses) + 2)
    for photo, first in zip(photos, shown, strict=True):
        window = _window(photo, world_from_part, guesses, body)
        if window is not None:
            scores += _in_photo(photo, world_from_part, guesses, body, window, first)
    return scores[:-2], float(scores[-2]), float(scores[-1])


def _window(photo: Photo, world_from_part: Rigid, guesses: Sequence[Part], body: int) -> Window | None:
    """Return the rows and columns of a photo in which any of the guesses has a body; None if none has."""
    points = []
    for part in guesses:
        mesh = part.scene.mesh
        points.append(mesh.vertices[np.unique(mesh.faces[mesh.part == body])])
    return window_of(photo, world_from_part, np.concatenate(points))


def window_of(photo: Photo, world_from_part: Rigid, p: Array) -> Window | None:
    """Return the rows and columns of a photo that tell of a body with points p (n, 3) mm; None if none is in view."""
    q = photo.camera.project(photo.camera_from_world @ world_from_part @ p)
    q = q[np.isfinite(q).all(axis=1)]
    if not len(q):
        return None
    low = np.clip(np.floor(q.min(axis=0)) - 2 * _RIM_PX, 0, photo.camera.size).astype(int)
    high = np.clip(np.ceil(q.max(axis=0)) + 2 * _RIM_PX, 0, photo.camera.size).astype(int)
    return (slice(low[1], high[1]), slice(low[0], high[0])) if (high > low).all() else None


def _in_photo(
    photo: Photo, world_from_part: Rigid, guesses: Sequence[Part], body: int, window: Window, first: ShownFaces
) -> Array:
    from scipy.ndimage import binary_dilation

    shown = [replace(first, face=first.face[window])]
    shown += [ShownFaces.of(part, photo, world_from_part, window=window) for part in guesses[1:]]
    shown.append(ShownFaces.of(guesses[0], photo, world_from_part, without=body, window=window))
    shown.append(replace(shown[0], face=np.where(shown[0].shows(body), 0, shown[0].face).astype(np.int32)))
    covered = np.any([s.shows(body) for s in shown], axis=0)
    if not covered.any():
        return np.zeros(len(shown))
    where = np.zeros(photo.gray.shape, bool)
    where[window] = binary_dilation(covered, iterations=_RIM_PX) & ~_in_glare(photo.gray[window], shown[:-1])
    if not where.any():
        return np.zeros(len(shown))
    light, noise = first.light(photo, without=where), noise_of(photo.gray)
    pixels = _WindowPixels.of(photo.gray[window].astype(np.float64), where[window], in_window(window)[:2])
    skies = [Sky.of(part, photo, world_from_part, window) for part in guesses]
    skies += [replace(skies[0], without=body), skies[0]]
    return np.array([_log_likelihood(s, pixels, light, noise, sky) for s, sky in zip(shown, skies, strict=True)])


def _in_glare(gray: Picture, shown: Sequence[ShownFaces]) -> Mask:
    """Return which pixels (h, w) are white where the part is seen in any case: glare, which shows nothing of it."""
    return np.asarray((gray >= BRIGHT) & np.all([s.color[s.face] >= 0 for s in shown], axis=0))


@dataclass(frozen=True, slots=True, eq=False)
class _WindowPixels:
    """The pixels of a window that count, and the n pixels that blur mixes into them.

    shape: of the window; at (2, n): row and column in it, q (n, 2): place in the photo; counts (n,): whether a pixel
    counts itself; gray (n,).
    """

    shape: tuple[int, int]
    at: Longs
    q: Array
    counts: Mask
    gray: Array

    @classmethod
    def of(cls, gray: Array, where: Mask, corner: tuple[int, int]) -> _WindowPixels:
        """Return the pixels `where` (h, w) of a window that count, and those around them; corner: left and top."""
        from scipy.ndimage import maximum_filter

        near = maximum_filter(where, 2 * _BLURRED_PX + 1)
        at = np.array(np.nonzero(near))
        q = (at[::-1].T + corner).astype(np.float64)
        return cls((where.shape[0], where.shape[1]), at, q, where[near], gray[near])

    def blurred(self, value: Array) -> Array:
        """Return values (n,) blurred as in the photo, for the pixels that count."""
        from scipy.ndimage import gaussian_filter

        picture = np.zeros(self.shape)
        picture[tuple(self.at)] = value
        out = gaussian_filter(picture, _BLUR_PX, mode="nearest", radius=_BLURRED_PX)
        return np.asarray(out[tuple(self.at)][self.counts])


def _log_likelihood(shown: ShownFaces, pixels: _WindowPixels, light: FittedLight, noise: float, sky: Sky) -> float:
    """Return the log likelihood of the pixels that count, up to a constant, marginalised over the tones."""
    patches = _Patches.of(shown, pixels, sky)
    tone, off = patches.tones(light)
    sigma = float(np.hypot(noise, light.scale))
    shade, costs = _shade(pixels, pixels.gray - tone, patches.surface, off, sigma)
    loss = np.minimum(((pixels.gray[pixels.counts] - pixels.blurred(tone + shade)) / sigma) ** 2, _WORST).sum()
    return float(-0.5 * (loss / _TOGETHER + costs))


@dataclass(frozen=True, slots=True, eq=False)
class _Patches:
    """The connected patches that the n pixels of a window show, each facing roughly one way; of many, by surface.

    Parallel faces that are not connected are two: a screw's head may shine, and its socket be dark. patch (n,): of each
    pixel; of each patch (k,), normal (k, 3), color, open: see `Sky`, large: whether it has a tone of its own. Of
    each surface (s,): own_normal (s, 3), own_color; own (n,): of each pixel.
    """

    patch: Longs
    normal: Array
    color: Ids
    open: Array
    large: Mask
    own: Longs
    own_normal: Array
    own_color: Ids

    @classmethod
    def of(cls, shown: ShownFaces, pixels: _WindowPixels, sky: Sky) -> _Patches:
        """Return the patches that a part shows in the pixels of a window."""
        face = shown.face[tuple(pixels.at)]
        by_surface = shown.surface * (int(shown.part.max(initial=0)) + 2) + shown.part
        for label in (shown.patch, by_surface):
            its, patch = _first_of_each(label[face], face)
            large = np.bincount(patch[pixels.counts], minlength=len(its)) >= _OWN_PX
            if large.sum() <= _MOST_PATCHES:
                break
        asked = pixels.counts & (shown.color[its] >= 0)[patch]
        open_ = sky.of_groups(pixels.q, np.where(asked, patch, -1), len(its))
        of, own = _first_of_each(shown.surface[face], face)
        return cls(patch, shown.normal[its], shown.color[its], open_, large, own, shown.normal[of], shown.color[of])

    @property
    def surface(self) -> Longs:
        """The number (n,) of each pixel's surface with a tone: a large patch, all small ones, or those in cavities."""
        rest = int(self.large.sum()) + (self.open < CAVE)
        return np.asarray(np.where(self.large, np.cumsum(self.large) - 1, rest)[self.patch], np.int64)

    def tones(self, light: FittedLight) -> tuple[Array, Array]:
        """Return the brightness (n,) that the light predicts, and the covariance (s, s) of the surfaces' tones."""
        by_surface = light.brightness(self.own_normal, self.own_color)
        by_surface[self.own_color < 0] = light.nothing
        tone, V = light.brightness_and_covariance(self.normal[self.large], self.color[self.large])
        open_ = self.open[self.large]
        kept, variance = dimming(tone, open_)
        off = np.diag(np.full(len(tone) + 2, light.spread**2))
        off[:-2, :-2] = V * np.outer(kept, kept) + np.diag(variance + _UNEVEN**2)
        nothing = np.flatnonzero(self.color[self.large] < 0)
        off[nothing], off[:, nothing] = 0.0, 0.0
        off[nothing, nothing] = light.spread**2
        return by_surface[self.own] * dimming(by_surface[self.own], self.open[self.patch])[0], off


def _first_of_each(label: Longs, face: Ids) -> tuple[Ids, Longs]:
    """Return a face of each label (k,), and the number (n,) of each pixel's label."""
    _, first, number = np.unique(label, return_index=True, return_inverse=True)
    return face[first], np.asarray(number.reshape(-1), np.int64)


def _shade(pixels: _WindowPixels, left: Array, surface: Longs, off: Array, sigma: float) -> tuple[Array, float]:
    """Return by how much surfaces are brighter at the pixels (n,) than the light predicts, and the cost of that.

    left (n,): difference of the pixels' brightness in sigmas; surface (n,): of each pixel; off (k, k): covariance of
    the surfaces' tones. A light nearer than assumed gives each surface a small gradient. The cost is minus twice the
    logarithm of the probability of such tones, and of the volume of the alternatives (an Occam factor).
    """
    n, counts = len(off), pixels.counts
    count = np.maximum(np.bincount(surface[counts], minlength=n), 1)
    across = [v - (np.bincount(surface[counts], v[counts], minlength=n) / count)[surface] for v in pixels.at]
    basis = np.stack([np.ones(len(left)), _FALL * across[0], _FALL * across[1]])
    order = np.flatnonzero(counts)[np.argsort(surface[counts], kind="stable")]  # surface by surface: quick to sum
    own, B = left[order], basis[:, order]
    its, first, pixels_of = np.unique(surface[order], return_index=True, return_counts=True)
    weight = np.full(len(own), 1 / sigma**2)
    known = np.eye(3 * n)
    known[:n, :n] = np.linalg.inv(off)
    N = known
    found: Array = np.zeros(3 * n)
    for _ in range(_ROUNDS):
        N, b, W = known.copy(), np.zeros(3 * n), B * (weight / _TOGETHER)
        for i in range(3):
            b[i * n + its] = np.add.reduceat(W[i] * own, first)
            for j in range(i + 1):
                N[i * n + its, j * n + its] += np.add.reduceat(W[i] * B[j], first)
                N[j * n + its, i * n + its] = N[i * n + its, j * n + its]
        found = np.asarray(np.linalg.solve(N, b), np.float64)
        r = own - (np.repeat(found.reshape(3, n)[:, its], pixels_of, axis=1) * B).sum(axis=0)
        weight = np.minimum(1 / sigma**2, _WORST / np.maximum(r**2, 1e-12))
    number = surface + n * np.arange(3)[:, None]  # of each pixel's tone and gradients
    shade = (found[number] * basis).sum(axis=0)
    return shade, float(found @ known @ found + np.linalg.slogdet(N)[1] - np.linalg.slogdet(known)[1])
