"""The intensity Cramer-Rao bound of a pose from the visible edges of a photo: what no unbiased estimate goes below.

A step of contrast c, blurred by a Gaussian of standard deviation b px (optics and pixel together) and sampled with
noise sigma, tells its place along the normal with Fisher information c^2 / (2 sqrt(pi) b sigma^2) for each px of its
length: the integral of the squared derivative of the profile, c^2 / (2 sqrt(pi) b), over the noise's variance. A pose
moves the edge by n^T dq/dxi, so the information on the pose is the sum of the outer products of that, weighted so.
Contrast and blur are measured in the photo at the true edges. What else the photo tells (texture, shading, edges that
the model lacks) does not count; what an estimate must find out besides the pose (levels, blur) is not charged.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares
from scipy.special import ndtr

from cadcam.arrays import Array, Ids, Picture
from cadcam.camera.camera import Camera
from cadcam.geometry.rigid import Rigid
from cadcam.geometry.rotation import hat
from cadcam.locate.part import Part
from cadcam.render.lines.wireframe import Polylines

STEP_PX = 1.0  # between samples along an edge
PIECE = 12  # samples whose profiles are averaged
REACH = 4.0  # px of profile to either side: parallel edges are often 9 px apart
PROFILE = np.arange(-REACH, REACH + 0.25, 0.5)


@dataclass(frozen=True)
class Samples:
    """Places on visible edges: q, normal (N, 2) px, p (N, 3) mm in the camera frame, the piece and chain of each."""

    q: Array
    normal: Array
    p: Array
    piece: Ids
    chain: Ids


def edge_information(contrast: Array, blur_px: float, noise: float) -> Array:
    """Return the Fisher information, 1/px^2 for each px of edge, on the place of steps of these contrasts."""
    return np.asarray(contrast**2 / (2 * np.sqrt(np.pi) * blur_px * noise**2))


def samples(part: Part, camera: Camera, camera_from_part: Rigid) -> Samples:
    """Return samples of the visible lines, `STEP_PX` apart, well inside the picture."""
    lines = part.lines.draw(camera, camera_from_part).visible
    p, line = _along(lines, camera_from_part)
    q = camera.project(p)
    d = np.gradient(q, axis=0)
    first = np.flatnonzero(np.diff(line, prepend=-1))
    last = np.append(first[1:], len(line)) - 1
    inner = np.minimum(first + 1, last)
    d[first], d[last] = q[inner] - q[first], q[last] - q[np.maximum(last - 1, first)]
    length = np.linalg.norm(d, axis=1)
    normal = np.column_stack([-d[:, 1], d[:, 0]]) / np.maximum(length, 1e-12)[:, None]
    count = np.arange(len(line)) - np.repeat(first, np.diff(np.append(first, len(line))))
    _, piece = np.unique(np.column_stack([line, count // PIECE]), axis=0, return_inverse=True)
    margin = REACH + 1
    inside = ((q > margin) & (q < np.array(camera.size) - 1 - margin)).all(axis=1) & (length > 0)
    return Samples(
        q[inside], normal[inside], p[inside], piece.ravel()[inside].astype(np.int32), lines.chain[line[inside]]
    )


def _along(lines: Polylines, camera_from_part: Rigid) -> tuple[Array, Ids]:
    """Return p (N, 3) mm in the camera frame and the polyline of points about a step apart in the picture, in order."""
    P = camera_from_part @ lines.p
    of = lines.line_of_point
    a = np.flatnonzero(of[1:] == of[:-1])
    n = np.maximum(np.rint(np.linalg.norm(lines.q[a + 1] - lines.q[a], axis=1) / STEP_PX), 1).astype(int)
    index = np.repeat(a, n)
    t = (np.arange(len(index)) - np.repeat(np.cumsum(n) - n, n) + 0.5) / np.repeat(n, n)
    za, zb = P[index, 2], P[index + 1, 2]
    s = (t * za / ((1 - t) * zb + t * za))[:, None]  # equal steps in the picture are not equal in space
    return (1 - s) * P[index] + s * P[index + 1], np.asarray(of[index], np.int32)


def profiles(gray: Picture, s: Samples) -> tuple[Array, Array]:
    """Return the mean profiles (P, len(PROFILE)) of the pieces along their normals, and their lengths (P,) px."""
    from scipy.ndimage import map_coordinates

    at = s.q[:, None, :] + PROFILE[:, None] * s.normal[:, None, :]
    values = map_coordinates(np.asarray(gray, float), (at[..., 1], at[..., 0]), order=1, mode="nearest")
    n = np.bincount(s.piece).astype(float)
    total = np.zeros((len(n), len(PROFILE)))
    np.add.at(total, s.piece, values)
    return total / np.maximum(n, 1)[:, None], n * STEP_PX


def blur_of(means: Array, lengths: Array) -> float:
    """Return the blur in px: the median of blurred steps fitted to the pieces of most contrast."""
    rise = np.where(lengths >= PIECE - 1, np.abs(means[:, -1] - means[:, 0]), 0)
    strong = np.argsort(rise)[::-1][: max(len(rise) // 5, 5)]
    fits = []
    for y in means[strong]:

        def misfit(x: Array, y: Array = y) -> Array:
            design = _design(PROFILE - x[0], x[1])
            return np.asarray(design @ np.linalg.lstsq(design, y)[0] - y)

        fit = least_squares(misfit, [0.0, 0.8], bounds=([-1.5, 0.3], [1.5, 3.0]))
        fits.append(fit.x[1])
    interpolation = 1 / 6  # px^2: bilinear sampling of a pixel grid blurs by this variance on average
    return float(np.sqrt(max(np.median(fits) ** 2 - interpolation, 0.04)))


def photo_blur(gray: Picture, part: Part, camera: Camera, camera_from_part: Rigid) -> float:
    """Return the blur in px of a photo's edges at the true pose."""
    return blur_of(*profiles(gray, samples(part, camera, camera_from_part)))


def contrasts(means: Array, blur_px: float) -> Array:
    """Return the step (P,) in grey of each piece at its true place, beside a level and a slope."""
    design = _design(PROFILE, np.hypot(blur_px, np.sqrt(1 / 6)))
    return np.asarray(np.linalg.lstsq(design, means.T)[0][2])


def _design(x: Array, b: float) -> Array:
    return np.column_stack([np.ones_like(x), x / REACH, ndtr(x / b)])


def information(gray: Picture, part: Part, camera: Camera, camera_from_part: Rigid, noise: float) -> Array:
    """Return the information (6, 6) on xi: shift (mm) of the part's centroid and turn (rad) about it, camera axes.

    gray: the photo without noise; noise: the standard deviation, in grey levels of its scale, that it would have.
    """
    s = samples(part, camera, camera_from_part)
    means, lengths = profiles(gray, s)
    blur = blur_of(means, lengths)
    weight = edge_information(contrasts(means, blur), blur, noise)[s.piece] * STEP_PX
    J = motion(camera, s, camera_from_part @ part.scene.mesh.vertices.mean(axis=0))
    return np.asarray((J * weight[:, None]).T @ J)


def motion(camera: Camera, s: Samples, centre: Array) -> Array:
    """Return J (N, 6): how samples move along their normals, px, with shifts and turns about `centre`."""
    _, dq = camera.project_with_jacobian(s.p)
    row = np.einsum("ni,nij->nj", s.normal, dq)
    return np.concatenate([row, np.einsum("ni,nij->nj", row, -hat(s.p - centre))], axis=1)


def bound(information: Array) -> Array:
    """Return the smallest standard deviations (6,): of the centroid's shift in mm and the turn in rad."""
    return np.asarray(np.sqrt(np.diag(np.linalg.inv(information))))
