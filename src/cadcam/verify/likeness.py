"""How much photos look like the part with its bodies drawn in some places: surfaces as bright as the light makes them.

Edges alone are taken for each other where a displacement brings one near another's place. What lies between them is
not: a wrong guess leaves strips of a wrong tone beside every edge. Places of a body are compared by all pixels that it
covers in any of them. The pixels of a surface are off together, as far as the light is not known: each surface has its
own tone, about as bright as the light makes it, and falling slowly along it; a guess is not preferred because it puts
a surface where a tone that is wrong for all of it would be less so. Neighbouring pixels are off together too, and some
by anything: their squared residuals are bounded, and each counts as a small part of an observation.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Array, Mask, Picture
from cadcam.geometry.rigid import Rigid
from cadcam.image.profile import noise_of
from cadcam.locate.light import Light, fitted_light, surfaces
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.verify.tones import Drawn, Window

Longs = npt.NDArray[np.int64]
_RIM_PX = 4  # around a body's picture that counts too
_BLUR_PX = 0.7  # of the photo, about
_WORST = 9.0  # squared sigmas that a pixel is off at most
_TOGETHER = 12.0  # pixels that count as one
_OWN_PX = 100  # of a surface that has its own tone
_FALL = 5e-4  # of brightness along a surface, for each px: standard deviation
_ROUNDS = 3


def likenesses(
    photos: Sequence[Photo], world_from_part: Rigid, guesses: Sequence[Part], body: int
) -> tuple[Array, float]:
    """Return the log likelihoods (k,) of what the photos show where any of the guesses has a body, and that without it.

    Up to a common constant. guesses: the part, that body drawn in several places.
    """
    scores = np.zeros(len(guesses) + 1)
    for photo in photos:
        camera_from_part = photo.viewpoint.camera_from_world @ world_from_part
        window = _window(photo, camera_from_part, guesses, body)
        if window is not None:
            scores += _in_photo(photo, camera_from_part, guesses, body, window)
    return scores[:-1], float(scores[-1])


def _window(photo: Photo, camera_from_part: Rigid, guesses: Sequence[Part], body: int) -> Window | None:
    """Return the rows and columns of a photo in which any of the guesses has a body; None where none has."""
    points = []
    for part in guesses:
        mesh = part.scene.mesh
        points.append(photo.camera.project(camera_from_part @ mesh.vertices[np.unique(mesh.faces[mesh.part == body])]))
    q = np.concatenate(points)
    q = q[np.isfinite(q).all(axis=1)]
    if not len(q):
        return None
    low = np.clip(np.floor(q.min(axis=0)) - 2 * _RIM_PX, 0, photo.camera.size).astype(int)
    high = np.clip(np.ceil(q.max(axis=0)) + 2 * _RIM_PX, 0, photo.camera.size).astype(int)
    return (slice(low[1], high[1]), slice(low[0], high[0])) if (high > low).all() else None


def _in_photo(photo: Photo, camera_from_part: Rigid, guesses: Sequence[Part], body: int, window: Window) -> Array:
    from scipy.ndimage import binary_dilation

    drawn = [Drawn.of(part, photo, camera_from_part, window=window) for part in guesses]
    drawn.append(Drawn.of(guesses[0], photo, camera_from_part, without=body, window=window))
    covered = np.any([d.part == body for d in drawn], axis=0)
    if not covered.any():
        return np.zeros(len(drawn))
    where = np.zeros(photo.gray.shape, bool)
    where[window] = binary_dilation(covered, iterations=_RIM_PX)
    whole = Drawn.of(guesses[0], photo, camera_from_part)
    light = fitted_light(photo.gray, whole.normal, whole.color, without=where)
    noise = noise_of(photo.gray)
    return np.array([_log_likelihood(d, photo.gray[window], where[window], light, noise) for d in drawn])


def _log_likelihood(drawn: Drawn, gray: Picture, where: Mask, light: Light, noise: float) -> float:
    """Return the log likelihood of the pixels `where` (h, w) of a window, up to a constant, whatever the tones are."""
    from scipy.ndimage import gaussian_filter

    normal, color, part = drawn.normal.reshape(-1, 3), drawn.color.ravel(), drawn.part.ravel()
    kind = surfaces(normal, color) * (int(part.max(initial=0)) + 2) + part  # of one surface and part, one number
    _, first, at = np.unique(kind, return_index=True, return_inverse=True)
    tone, V = light.brightness(normal[first], color[first])
    nothing = color[first] < 0
    tone[nothing], V[nothing], V[:, nothing] = light.nothing, 0.0, 0.0
    V[nothing, nothing] = light.spread**2
    at = at.reshape(gray.shape)
    large = np.bincount(at[where], minlength=len(tone)) >= _OWN_PX
    k = int(large.sum())
    number = np.where(large, np.cumsum(large) - 1, k)  # small ones are off together
    off = np.diag(np.full(k + 1, light.spread**2))
    off[:k, :k] = V[np.ix_(large, large)]
    sigma = float(np.hypot(noise, light.scale))
    shade, costs = _shade(gray - tone[at], where, number[at], off, sigma)
    expected = gaussian_filter(tone[at] + shade, _BLUR_PX, mode="nearest")
    loss = np.minimum(((gray - expected) / sigma) ** 2, _WORST)[where].sum() / _TOGETHER
    return float(-0.5 * (loss + costs))


def _shade(left: Array, where: Mask, surface: Longs, off: Array, sigma: float) -> tuple[Array, float]:
    """Return by how much (h, w) surfaces are brighter than the light has it, and what it costs to take it so.

    left (h, w): what the pixels `where` are brighter, each by sigma; surface (h, w): of each pixel; off (n, n): how far
    surfaces may be off. The light may also be nearer than it is taken to be, so that brightness falls along a surface,
    slowly. The cost is minus twice the logarithm of the probability of such tones, and of the room there was to choose.
    """
    n, places = len(off), np.indices(left.shape)
    count = np.maximum(np.bincount(surface[where], minlength=n), 1)
    across = [v - (np.bincount(surface[where], v[where], minlength=n) / count)[surface] for v in (places[0], places[1])]
    basis = np.stack([np.ones(left.shape), _FALL * across[0], _FALL * across[1]])
    number = surface + n * np.arange(3)[:, None, None]  # of each pixel's tone and falls
    B, its, weight = basis[:, where], surface[where], np.full(int(where.sum()), 1 / sigma**2)
    known = np.eye(3 * n)
    known[:n, :n] = np.linalg.inv(off)
    found, N = np.zeros(3 * n), known
    for _ in range(_ROUNDS):
        W = B * weight / _TOGETHER
        N, b = known.copy(), np.concatenate([np.bincount(its, w * left[where], minlength=n) for w in W])
        for i, j in np.ndindex(3, 3):
            N[i * n + np.arange(n), j * n + np.arange(n)] += np.bincount(its, W[i] * B[j], minlength=n)
        found = np.linalg.solve(N, b)
        r = left[where] - (found[number[:, where]] * B).sum(axis=0)
        weight = np.minimum(1 / sigma**2, _WORST / np.maximum(r**2, 1e-12))
    shade = (found[number] * basis).sum(axis=0)
    return shade, float(found @ known @ found + np.linalg.slogdet(N)[1] - np.linalg.slogdet(known)[1])
