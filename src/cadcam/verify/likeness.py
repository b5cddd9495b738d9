"""How much photos look like the part with its bodies drawn in some places: surfaces as bright as the light makes them.

Edges alone are taken for each other where a displacement brings one near another's place. What lies between them is
not: a wrong guess leaves strips of a wrong tone beside every edge. Places of a body are compared by all pixels that it
covers in any of them. Neighbouring pixels are off together, and some by anything: their squared residuals are bounded,
and each counts as a small part of an observation.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cadcam.arrays import Array, Mask, Picture
from cadcam.geometry.rigid import Rigid
from cadcam.image.profile import noise_of
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.verify.light import Light, fitted_light, surfaces
from cadcam.verify.tones import Drawn, Window

_RIM_PX = 4  # around a body's picture that counts too
_BLUR_PX = 0.7  # of the photo, about
_WORST = 9.0  # squared sigmas that a pixel is off at most
_TOGETHER = 12.0  # pixels that count as one


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
    """Return the log likelihood of the pixels `where` (h, w) of a window, up to a constant."""
    from scipy.ndimage import gaussian_filter

    normal, color = drawn.normal.reshape(-1, 3), drawn.color.ravel()
    _, first, at = np.unique(surfaces(normal, color), return_index=True, return_inverse=True)
    tone, V = light.brightness(normal[first], color[first])
    tone[color[first] < 0] = light.nothing
    sigma = np.sqrt(np.diag(V) + noise**2)[at].reshape(gray.shape)
    expected = gaussian_filter(tone[at].reshape(gray.shape), _BLUR_PX, mode="nearest")
    loss = np.minimum(((gray - expected) / sigma) ** 2, _WORST) + 2 * np.log(sigma)
    return float(-0.5 * loss[where].sum() / _TOGETHER)
