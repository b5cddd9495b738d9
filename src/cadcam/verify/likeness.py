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
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.locate.light import Light, fitted_light, surfaces
from cadcam.verify.tones import Drawn, Window

Longs = npt.NDArray[np.int64]
_RIM_PX = 4  # around a body's picture that counts too
_BLUR_PX = 0.7  # of the photo, about
_WORST = 9.0  # squared sigmas that a pixel is off at most
_TOGETHER = 12.0  # pixels that count as one
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
    _, first, at = np.unique([surfaces(normal, color), part], axis=1, return_index=True, return_inverse=True)
    tone, V = light.brightness(normal[first], color[first])
    nothing = color[first] < 0
    tone[nothing], V[nothing], V[:, nothing] = light.nothing, 0.0, 0.0
    V[nothing, nothing] = light.spread**2
    sigma = float(np.hypot(noise, light.scale))
    shaded, costs = _shaded(gray, where, at.reshape(gray.shape), tone, V, sigma)
    expected = gaussian_filter(shaded, _BLUR_PX, mode="nearest")
    loss = np.minimum(((gray - expected) / sigma) ** 2, _WORST)[where].sum() / _TOGETHER
    return float(-0.5 * (loss + costs))


def _shaded(
    gray: Picture, where: Mask, surface: Longs, tone: Array, V: Array, sigma: float
) -> tuple[Array, float]:
    """Return the brightness (h, w) of surfaces that the pixels `where` tell, and what it costs to take it for theirs.

    surface (h, w): of each pixel; tone (n,), V (n, n): their brightness as the light has it. The light may be nearer
    than it is taken to be, so that brightness falls along a surface, slowly. The cost is minus twice the logarithm of
    the probability of such tones, and of how much room was left to choose them.
    """
    n, (y, x) = len(tone), np.indices(gray.shape)
    count = np.maximum(np.bincount(surface[where], minlength=n), 1)
    across = [v - (np.bincount(surface[where], v[where], minlength=n) / count)[surface] for v in (x, y)]
    basis = np.stack([np.ones(gray.shape), _FALL * across[0], _FALL * across[1]])
    known = np.eye(3 * n)
    known[:n, :n] = np.linalg.inv(V)
    at = (surface[where] + n * np.arange(3)[:, None]).astype(np.int64)  # numbers of the tones and falls of each pixel
    B, g, weight = basis[:, where], gray[where].astype(np.float64), np.ones(int(where.sum()))
    found, N = np.zeros(3 * n), known
    for _ in range(_ROUNDS):
        N, b = known.copy(), known[:, :n] @ tone
        for i in range(3):
            b += np.bincount(at[i], weight * B[i] * g, minlength=3 * n) / (_TOGETHER * sigma**2)
            for j in range(3):
                told = np.bincount(at[0], weight * B[i] * B[j], minlength=n) / (_TOGETHER * sigma**2)
                N[i * n + np.arange(n), j * n + np.arange(n)] += told
        found = np.linalg.solve(N, b)
        r = g - (found[at] * B).sum(axis=0)
        weight = np.minimum(1.0, _WORST * sigma**2 / np.maximum(r**2, 1e-12))
    off = found - np.append(tone, np.zeros(2 * n))
    shaded = (found[surface + n * np.arange(3)[:, None, None]] * basis).sum(axis=0)
    return shaded, float(off @ known @ off + np.linalg.slogdet(N)[1] - np.linalg.slogdet(known)[1])
