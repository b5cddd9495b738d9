"""Marks fitted to the grey values: position, shape or pose, levels, light and blur, each with its covariance.

Without a camera the map from the mark's plane is affine (what is measured is the centre of the borders' image), or has
its two perspective terms free where a mark has several borders. With a camera the pose is fitted through the whole
camera, lens included, and the result is the image of the mark's *centre*: the bias of ellipse centres (Heikkila, PAMI
22, 2000) does not arise. A single mark has two tilts that look nearly alike; both are tried.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from cadcam.arrays import Array, Ids, Index, Mask, Picture
from cadcam.camera.camera import Camera
from cadcam.geometry import rotation as so3
from cadcam.geometry.rigid import Rigid
from cadcam.image.profile import BRIGHT, DARK, noise_of
from cadcam.native.marks import LOOSE
from cadcam.target.boards.photometric import BLUR, CONTRAST, Fit
from cadcam.target.marks.mark import Mark
from cadcam.target.marks.model import Geometry, affine, posed, predicted, share_of_ink
from cadcam.target.marks.occlusion import clear_fit
from cadcam.target.marks.response import may_be_marks, rough_fit
from cadcam.target.marks.window import MARGIN, Window, batches, by_size

_MOST_HIDDEN, _MOST_OUTSIDE = 0.6, 0.4  # shares of a window
_SOFTEST, _SOFT = 0.6, 3.0  # blur over the smaller radius, and px: with more of both, anything smooth fits
_TOGETHER = 256  # windows processed at a time
_SPARSE = 1.5  # over the blur: distance of the pixels at which blurred pictures are compared


@dataclass(frozen=True, slots=True, eq=False)
class MarkFit:
    """B fitted marks: q (B, 2) px, covariance (B, 2, 2) px^2, and the other results of the fit.

    image_from_mark (B, 2, 2): px per mm at the centre, its columns the images of the mark's x and y (for a concentric
    mark symmetric: its rotation is not observable); contrast (B,) observed ground minus mark; blur (B,) px. score (B,):
    correlation of the fitted model with the grey values, less what is hidden or cut off. hidden, outside, clipped (B,):
    shares of the window that show something else, that lie outside the picture, that are black or white. good (B,);
    poses: camera_from_mark of each, where a camera was given, and doubt (B,): the probability of the other tilt.
    """

    q: Array
    covariance: Array
    image_from_mark: Array
    contrast: Array
    blur: Array
    misfit: Array
    score: Array
    hidden: Array
    outside: Array
    clipped: Array
    good: Mask
    doubt: Array
    poses: tuple[Rigid, ...] | None = None

    def __len__(self) -> int:
        return len(self.q)

    def subset(self, which: Index) -> MarkFit:
        """Return the marks that `which` selects, in its order."""
        arrays = {name: getattr(self, name)[which] for name in MarkFit.__slots__ if name != "poses"}
        return MarkFit(**arrays, poses=None if self.poses is None else tuple(self.poses[i] for i in which))


def fit_marks(
    gray: Picture,
    mark: Mark,
    q: Array,
    image_from_mark: Array,
    *,
    perspective: bool = False,
    margin: float = MARGIN,
    blur: float = 1.0,
    roughly: bool = False,
) -> MarkFit:
    """Return marks fitted near q (B, 2) px, starting from shapes (B, 2, 2) px per mm; no camera is needed.

    perspective: whether the plane's two perspective terms are free; only a mark of several borders determines them.
    margin: width of ground in the window, over the radius; keep clear of neighbours. Pixels that contradict the mark
    (something covers it) are left out, unless the fit need only be near (roughly): of clutter most contradicts it.
    """
    groups = batches(mark, image_from_mark, margin)
    if len(groups) > 1:
        parts = [
            fit_marks(
                gray, mark, q[k], image_from_mark[k], perspective=perspective, margin=margin, blur=blur, roughly=roughly
            )
            for k in groups
        ]
        return joined(parts, groups)
    geometry = affine(turned=not mark.concentric, perspective=perspective)
    A = np.linalg.inv(_symmetric(image_from_mark) if mark.concentric else image_from_mark)
    window = Window.around(gray, q, image_from_mark, mark, margin)
    g = np.zeros((len(q), geometry.count))
    g[:, 2], g[:, 3], g[:, 4] = A[:, 0, 0], A[:, 0, 1], A[:, 1, 1]
    if not mark.concentric:
        g[:, 5] = A[:, 1, 0]
    start = _start(mark, geometry, g, np.zeros((len(q), 0)), window, blur)
    if roughly:
        fit, weight = rough_fit(mark, geometry, start, window, q), window.weight
    else:
        fit, weight = clear_fit(mark, geometry, start, window, q, noise=noise_of(gray))
    shapes = np.asarray(np.linalg.inv(geometry.homography(fit.parameters)[:, :2, :2]), np.float64)
    seen = predicted(mark, geometry, fit.parameters, window.pixels)
    return _result(fit, weight, shapes, window, seen)


def joined(parts: list[MarkFit], groups: list[Ids]) -> MarkFit:
    """Return the fits of groups of marks in the original order of the marks."""
    back = np.argsort(np.concatenate(groups))
    names = [name for name in MarkFit.__slots__ if name != "poses"]
    arrays = {name: np.concatenate([getattr(part, name) for part in parts])[back] for name in names}
    poses = [pose for part in parts for pose in part.poses or ()]
    return MarkFit(**arrays, poses=tuple(poses[i] for i in back) if poses else None)


def likeness(
    gray: Picture,
    mark: Mark,
    q: Array,
    image_from_mark: Array,
    *,
    margin: float = MARGIN,
    soft: float,
    sparser: int = 1,
) -> Array:
    """Return the correlation (B,) of grey values with the mark predicted at q (B, 2), blurred by `soft` radii.

    sparser: with every how many of the rows and columns that the blur needs, for a quick answer.
    """
    if not len(q):
        return np.zeros(0)
    major, minor = mark.radius * np.linalg.svd(image_from_mark, compute_uv=False).T
    out = np.zeros(len(q))
    for group in by_size(np.asarray(major)):
        for some in np.array_split(group, 1 + len(group) // _TOGETHER):
            step = sparser * max(1, int(soft * minor[some].min(initial=np.inf) / _SPARSE))
            window = Window.around(gray, q[some], image_from_mark[some], mark, margin, step)
            H = np.zeros((len(some), 3, 3))
            H[:, :2, :2], H[:, 2, 2] = np.linalg.inv(image_from_mark[some]), 1.0
            share = share_of_ink(mark, H, window.pixels, np.maximum(soft * window.size, 1.0))
            out[some] = _correlation(share if mark.light else -share, window.values, window.weight)
    return out


def _correlation(a: Array, b: Array, weight: Array) -> Array:
    n = np.maximum(weight.sum(axis=1, keepdims=True), 1.0)
    a, b = (weight * (v - (weight * v).sum(axis=1, keepdims=True) / n) for v in (a, b))
    return np.asarray((a * b).sum(axis=1) / np.sqrt(np.maximum((a * a).sum(axis=1) * (b * b).sum(axis=1), 1e-12)))


@dataclass(frozen=True, slots=True, eq=False)
class CameraFit:
    """Intermediate results of a fit through a camera: windows about q (B, 2), weight (B, P) of kept pixels, parameters.

    L (B, 3, 3): rays from local coordinates about q; scale (B,): factor by which the start's centre is L (0, 0, 1);
    parameters (B, n); shared (B,): see `Fit`.
    """

    window: Window
    weight: Array
    parameters: Array
    q: Array
    L: Array
    scale: Array
    shared: Array


def seen_through(
    gray: Picture, mark: Mark, camera: Camera, starts: tuple[Rigid, ...], *, margin: float, blur: float
) -> tuple[MarkFit, CameraFit]:
    """Return marks fitted through a camera from rough poses (camera_from_mark), and the fit's intermediate results.

    q are the images of the marks' centres.
    """
    origin = np.array([pose.translation for pose in starts]).reshape(-1, 3)
    R = np.array([pose.rotation for pose in starts]).reshape(-1, 3, 3)
    q, J = camera.project_with_jacobian(origin)
    shapes = J @ R[..., :2]
    window = Window.around(gray, q, shapes, mark, margin)
    L, pixels = tangent(camera, q, window.pixels)
    scale = np.linalg.solve(L, origin[..., None])[..., 0][:, 2]  # scale L (0, 0, 1) is the centre
    geometry = posed(turned=not mark.concentric)
    held = (np.linalg.solve(L, R) / scale[:, None, None]).reshape(-1, 9)
    window = replace(window, pixels=pixels)
    start = _start(mark, geometry, np.zeros((len(q), geometry.count)), held, window, blur)
    fit, weight = clear_fit(mark, geometry, start, window, q, noise=noise_of(gray))
    poses = _poses(fit, geometry, L, R, scale)
    centre, J = camera.project_with_jacobian(np.array([pose.translation for pose in poses]).reshape(-1, 3))
    shapes = J @ np.array([pose.rotation for pose in poses]).reshape(-1, 3, 3)[..., :2]
    seen = predicted(mark, geometry, fit.parameters, window.pixels)
    result = replace(_result(replace(fit, q=centre), weight, shapes, window, seen), poses=poses)
    return result, CameraFit(window, weight, fit.parameters, q, L, scale, fit.shared)


def _symmetric(S: Array) -> Array:
    """Return the symmetric P with P P^T = S S^T: the same shape, for a mark whose rotation is not observable."""
    U, s, _ = np.linalg.svd(S)
    return np.asarray((U * s[:, None, :]) @ np.swapaxes(U, 1, 2))


def _start(mark: Mark, geometry: Geometry, g: Array, held: Array, window: Window, blur: float) -> Array:
    """Return parameters (B, n) whose levels fit the picture in the least squares sense."""
    start = np.zeros((len(g), geometry.free + LOOSE + held.shape[1]))
    start[:, geometry.places], start[:, geometry.free + LOOSE :] = g, held
    start[:, BLUR] = blur
    share = share_of_ink(mark, geometry.homography(start), window.pixels, start[:, BLUR])
    w = window.weight
    n = np.maximum(w.sum(axis=1), 1.0)
    mean_share, mean = ((w * v).sum(axis=1) / n for v in (share, window.values))
    off = (share - mean_share[:, None]) * w
    start[:, CONTRAST] = (off * window.values).sum(axis=1) / np.maximum((off * off).sum(axis=1), 1e-9)
    start[:, 6] = mean - start[:, CONTRAST] * mean_share
    return start


def _result(fit: Fit, weight: Array, image_from_mark: Array, window: Window, seen: Array) -> MarkFit:
    c = fit.parameters[:, CONTRAST]
    total = np.maximum(window.weight.sum(axis=1), 1)
    hidden = 1 - weight.sum(axis=1) / total
    score = _correlation(np.nan_to_num(seen), window.values, weight) * np.sqrt((1 - hidden) * (1 - window.outside))
    dark_or_white = (window.values <= DARK) | (window.values >= BRIGHT)
    clipped = (weight * dark_or_white).sum(axis=1) / total
    good = fit.good & (fit.parameters[:, BLUR] < np.maximum(_SOFTEST * window.size, _SOFT))
    good &= may_be_marks(fit, window) & (window.outside < _MOST_OUTSIDE) & (hidden < _MOST_HIDDEN)
    return MarkFit(
        fit.q,
        fit.covariance,
        image_from_mark,
        -c,
        fit.parameters[:, BLUR],
        fit.misfit,
        score,
        hidden,
        window.outside,
        clipped,
        good,
        np.zeros(len(c)),
    )


def tangent(camera: Camera, q: Array, pixels: Array) -> tuple[Array, Array]:
    """Return L (B, 3, 3), rays (up to scale) from local coordinates, and the pixels (B, P, 8) with those.

    Local coordinates lie in the tangent plane at q: (u, v) to first order, and straight lines are straight.
    """
    ray = camera.unproject(q)
    _, J = camera.project_with_jacobian(ray)
    # dq = J dray; across the ray the minimum-norm inverse
    B = J @ np.swapaxes(J, 1, 2)
    across = np.swapaxes(J, 1, 2) @ np.linalg.inv(B)
    L = np.concatenate([across, ray[..., None]], axis=2)
    inverse = np.linalg.inv(L)

    def local(pixel: Array) -> Array:
        v = camera.unproject(q[:, None] + pixel) @ np.swapaxes(inverse, 1, 2)
        return np.asarray(v[..., :2] / v[..., 2:])

    h = 0.5
    slope = np.stack([(local(pixels + step) - local(pixels - step)) / (2 * h) for step in h * np.eye(2)], axis=-1)
    m = local(pixels)
    flat = slope.reshape(*slope.shape[:2], 4)
    rays = np.concatenate([pixels, m, flat], axis=2)
    return L, np.nan_to_num(rays)


def _poses(fit: Fit, geometry: Geometry, L: Array, R: Array, scale: Array) -> tuple[Rigid, ...]:
    g = fit.parameters[:, geometry.places]
    w = np.zeros((len(g), 3))
    w[:, : geometry.count - 3] = g[:, 3:]
    xy1 = np.column_stack([g[:, :2], np.ones(len(g))])
    t = (scale * np.exp(g[:, 2]))[:, None] * (L @ xy1[..., None])[..., 0]
    turned = R @ so3.exp(w)
    return tuple(Rigid(so3.nearest(turned[i]), t[i]) for i in range(len(g)))
