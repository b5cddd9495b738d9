"""What a part's faces show that its model lacks, print, grain or dirt, learned from frames and followed in others.

Where the pose is sure, patches of the photo are taken off the part's faces: a keyframe. A later frame is aligned with
one: the pose at which all patches look there as they did, each of its own brightness and contrast (B. Lucas, T. Kanade,
"An iterative image registration technique", IJCAI 1981, over the motions of a rigid part). That tells how the part moved
since the keyframe to a small part of what edges tell, but not where it was: a keyframe errs by the pose that it was
learned at. So it is one more piece of evidence beside the edges of each frame, and they hold it where it is (L.
Vacchetti, V. Lepetit, P. Fua, "Stable real-time 3D tracking using online and offline information", PAMI 26, 2004).

A keyframe is moved by what the edges of each frame that follows it say, and counts as so many frames' edges, up to
`_FRAMES`: what they err by at random averages out, what changes with the view is forgotten. What edges err by in all
frames alike does not average out, and the covariance that is told does not shrink by it (as in `locate.motion`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from cadcam.arrays import Array, Mask, Picture
from cadcam.camera.camera import Camera
from cadcam.camera.pose_estimate import PoseEstimate
from cadcam.geometry.rigid import Rigid
from cadcam.locate.evidence import PoseEvidence
from cadcam.locate.freedom import Freedom
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.locate.salient import corner_strength
from cadcam.render.view import Channel, Renderer

_EXTENT, _MARGIN = 320, 8  # px that the part takes at most where patches are compared, and what is kept around it
_BLURS = (2.5, 1.0)  # px: patches are aligned coarsely, then finely
_ROUNDS, _SETTLED_PX = (6, 6), 0.02
_OFFSETS = np.arange(-5.0, 6.0, 2.0)  # px: samples of a patch to each side
_APART, _MOST = 9, 80  # px between patches, and how many a photo gives at most
_INSIDE = 6  # px that a patch's middle stays from the part's outline and from bends
_BENT = 0.97  # cosine of normals within a patch
_STRUCTURE = 4.0  # times the noise: slope of a patch that can be followed in any direction
_FACING = 0.2  # cosine of the view from which a face is looked at
_ALIKE, _UNLIKE = 0.8, 0.5  # correlation of a patch that was found again, and of one that was not
_LEAST, _SHARE = 10, 0.5  # patches that must be found again, and the share of those in view
_TURN, _SCALE = math.radians(12.0), 0.12  # by which a view differs from its keyframe's before one more is learned
_KEPT = 12  # keyframes
_PATIENCE = 2  # frames that none is found again in, after which all are given up
_REACH, _SPARSE = 16, 4  # px around the start that patches are looked for in, where they are not found at once; samples
_FRAMES = 4.0  # that a keyframe counts as at most


@dataclass(frozen=True, slots=True, eq=False)
class Followed:
    """Where a keyframe's patches are in a frame: evidence of the pose; alone (6, 6): its covariance but for the keyframe's.

    number: of the keyframe; found: how many of its patches were found again.
    """

    evidence: PoseEvidence
    keyframe: Array
    alone: Array
    number: int
    found: int

    def told(self, fitted: Array) -> Array:
        """Return the covariance (6, 6) to be told of a pose fitted to this and to edges, `fitted` as if these were independent.

        They are not: what edges err by now they erred by when the keyframe was learned. So of errors e = R^(1/2) u both
        with the same u: (I - K) from the keyframe, K from the edges of the frame, where K is the share these had.
        """
        D = np.repeat([1.0, self.evidence.radius], 3)
        C, R, S, P = (D[:, None] * A * D for A in (fitted, self.keyframe, self.alone, self.evidence.covariance))
        by_edges = _pinv(C) - _pinv(P)
        values, axes = np.linalg.eigh(by_edges)
        root = (axes * np.sqrt(np.maximum(values, 0.0))) @ axes.T
        left = np.eye(6) - C @ root @ root
        L = left @ _root(R) + C @ root
        return (L @ L.T + left @ S @ left.T) / D[:, None] / D


@dataclass(frozen=True, slots=True, eq=False)
class _Patches:
    """P patches of one photo: p (P, n, 3) mm, normal (P, 3) in part axes; looks (2, P, n), of mean 0, coarse and fine."""

    p: Array
    normal: Array
    looks: Array


@dataclass(frozen=True, slots=True, eq=False)
class _Keyframe:
    """Patches of each photo, learned at a pose; what frames since say it was off by; what it counts as.

    off: pose @ off is where the part was. told (6, 6): covariance of that by one frame's edges; frames: how many say so.
    """

    patches: tuple[_Patches, ...]
    views: tuple[Rigid, ...]
    off: Rigid
    told: Array
    frames: float


class Texture:
    """The keyframes of a part, in the order they were learned."""

    def __init__(self, part: Part) -> None:
        self._part = part
        self._radius = part.aspects.radius
        self._keyframes: list[_Keyframe] = []
        self._misses = 0
        self._renderer: Renderer | None = None

    def forget(self) -> None:
        """Start anew, as after a loss."""
        self._keyframes.clear()
        self._misses = 0

    def follow(self, photos: Sequence[Photo], start: Rigid, freedom: Freedom) -> Followed | None:
        """Return where the part is by the keyframe seen most alike, from some px off; None where it is not seen again."""
        views = _views(photos, start)
        differ = [_difference(k.views, views) for k in self._keyframes]
        if not differ:
            return None
        number = int(np.argmin(differ))
        keyframe = self._keyframes[number]
        canvases = [_Canvas.of(photo, self._part, view) for photo, view in zip(photos, views, strict=True)]
        found = _aligned(keyframe.patches, canvases, photos, start, freedom)
        if found is None:
            found = _aligned(keyframe.patches, canvases, photos, _shifted(keyframe.patches, canvases, photos, start), freedom)
        if found is None:
            return None
        pose, alone, count = found
        covariance = keyframe.told / keyframe.frames + alone
        return Followed(
            PoseEvidence(pose @ keyframe.off, covariance, self._radius), keyframe.told, alone, number, count
        )

    def keep(self, photos: Sequence[Photo], pose: PoseEstimate, followed: Followed | None) -> None:
        """Take up a frame: where it showed the part, and by which keyframe it was followed, if by any."""
        if followed is None:
            self._misses += 1
            if not self._keyframes or self._misses > _PATIENCE:
                self.forget()
                self._learn(photos, pose, 1.0)
            return
        self._misses = 0
        keyframe = self._keyframes[followed.number]
        share = keyframe.told / keyframe.frames @ _inverse(followed.evidence.covariance, self._radius)
        moved = share @ (followed.evidence.world_from_part.inv @ pose.world_from_part).log()
        frames = min(keyframe.frames + 1, _FRAMES)
        told = keyframe.told + (pose.from_noise - keyframe.told) / frames
        self._keyframes[followed.number] = replace(
            keyframe, off=keyframe.off @ Rigid.exp(moved), told=told, frames=frames
        )
        if _difference(keyframe.views, _views(photos, pose.world_from_part)) > 1.0:
            self._learn(photos, pose, frames)

    def _learn(self, photos: Sequence[Photo], pose: PoseEstimate, frames: float) -> None:
        from cadcam.render import open_renderer

        if self._renderer is None:
            self._renderer = open_renderer(self._part.scene, threads=1)
        views = _views(photos, pose.world_from_part)
        patches = tuple(
            _learned(self._renderer, photo, _Canvas.of(photo, self._part, view), view)
            for photo, view in zip(photos, views, strict=True)
        )
        if sum(len(one.p) for one in patches) >= _LEAST:
            self._keyframes.append(_Keyframe(patches, tuple(views), Rigid(), pose.from_noise, frames))
            del self._keyframes[:-_KEPT]


@dataclass(frozen=True, slots=True, eq=False)
class _Canvas:
    """The surroundings of the part in a photo, reduced where they are large, and the camera that would take them so.

    layers: for each blur (H, W, 3): brightness, and its slopes along x and y.
    """

    camera: Camera
    layers: tuple[Picture, ...]

    @classmethod
    def of(cls, photo: Photo, part: Part, camera_from_part: Rigid) -> _Canvas | None:
        """Return the canvas of a photo; None where hardly anything of the part is in it."""
        low, high = part.scene.mesh.bounds
        corners = np.where(np.indices((2, 2, 2)).reshape(3, -1).T, high, low)
        q = photo.camera.project(camera_from_part @ corners)
        if not np.isfinite(q).all():
            return None
        by = max(1, math.ceil(float(np.ptp(q, axis=0).max()) / _EXTENT))
        size = np.array(photo.camera.size)
        first = np.clip(np.floor(q.min(axis=0)) - _MARGIN * by, 0, size - 1).astype(int)
        shape = (np.minimum(np.ceil(q.max(axis=0)) + _MARGIN * by, size).astype(int) - first) // by
        if shape.min() < 4 * _MARGIN:
            return None
        (x, y), (w, h) = (int(v) for v in first), (int(v) for v in shape)
        gray = photo.gray[y : y + h * by, x : x + w * by].reshape(h, by, w, by).mean(axis=(1, 3), dtype=np.float32)
        camera = photo.camera.crop(x, y, (w * by, h * by)).resize((w, h))
        return cls(camera, tuple(_layers(gray, blur) for blur in _BLURS))

    def sampled(self, level: int, q: Array) -> Array:
        """Return brightness and slopes (N, 3) at pixels q (N, 2); nan outside."""
        layers = self.layers[level]
        height, width, _ = layers.shape
        with np.errstate(invalid="ignore"):
            inside = ((q >= 0) & (q < [width - 1, height - 1])).all(axis=1)
        at = np.where(inside[:, None], q, 0.0)
        whole = at.astype(np.int64)
        u, v = (at - whole).T[:, :, None]
        index, flat = whole[:, 1] * width + whole[:, 0], layers.reshape(-1, 3)
        upper = flat[index] * (1 - u) + flat[index + 1] * u
        lower = flat[index + width] * (1 - u) + flat[index + width + 1] * u
        return np.where(inside[:, None], upper * (1 - v) + lower * v, np.nan)


def _layers(gray: Picture, blur: float) -> Picture:
    from scipy.ndimage import gaussian_filter

    smooth = gaussian_filter(gray, blur, truncate=3.0, mode="nearest")
    dy, dx = np.gradient(smooth)
    return np.stack([smooth, dx, dy], axis=-1)


def _views(photos: Sequence[Photo], world_from_part: Rigid) -> list[Rigid]:
    return [photo.viewpoint.camera_from_world @ world_from_part for photo in photos]


def _difference(one: Sequence[Rigid], other: Sequence[Rigid]) -> float:
    """Return how differently two frames show the part, 1 where it is worth a keyframe; turns in the picture do not count."""
    turned, scaled = 0.0, 0.0
    for a, b in zip(one, other, strict=True):
        eyes = [v.origin / np.linalg.norm(v.origin) for v in (a, b)]
        turned = max(turned, math.acos(float(np.clip(eyes[0] @ eyes[1], -1, 1))))
        turned = max(turned, 0.5 * float(np.linalg.norm((a.inv @ b).log()[3:])))
        scaled = max(scaled, abs(math.log(np.linalg.norm(a.translation) / np.linalg.norm(b.translation))))
    return max(turned / _TURN, scaled / _SCALE)


def _learned(renderer: Renderer, photo: Photo, canvas: _Canvas | None, camera_from_part: Rigid) -> _Patches:
    """Return the patches of a photo that are worth following."""
    from scipy.ndimage import distance_transform_edt, maximum_filter, minimum_filter

    n = len(_OFFSETS) ** 2
    none = _Patches(np.zeros((0, n, 3)), np.zeros((0, 3)), np.zeros((len(_BLURS), 0, n)))
    if canvas is None:
        return none
    view = renderer.render(canvas.camera, camera_from_part, channels=Channel.DEPTH | Channel.NORMAL)
    side = int(2 * _OFFSETS.max()) + 1
    fine = canvas.layers[-1]
    strength = corner_strength(fine[..., 0], side)
    normal = np.where(np.isfinite(view.depth)[..., None], view.normal, 0.0)
    bent = np.zeros(view.depth.shape, bool)
    for k in range(3):
        c = normal[..., k]
        bent |= maximum_filter(c, 3) - minimum_filter(c, 3) > math.sqrt(1 - _BENT**2)
    free = np.pad(np.isfinite(view.depth) & ~bent, 1)[1:-1, 1:-1]
    away = distance_transform_edt(np.pad(free, 1))[1:-1, 1:-1]
    noise = max(1.0 / 255, 0.0) * 0.3
    peak = (strength == maximum_filter(strength, _APART)) & (away > _INSIDE) & (strength > (_STRUCTURE * noise) ** 2)
    y, x = np.nonzero(peak)
    order = np.argsort(-strength[y, x], kind="stable")
    chosen: list[int] = []
    for k in order:
        if all(max(abs(x[k] - x[j]), abs(y[k] - y[j])) >= _APART for j in chosen):
            chosen.append(int(k))
        if len(chosen) == _MOST:
            break
    if not chosen:
        return none
    q = np.stack([x[chosen], y[chosen]], axis=1).astype(np.float64)
    dx, dy = np.meshgrid(_OFFSETS, _OFFSETS)
    every = q[:, None] + np.stack([dx.ravel(), dy.ravel()], axis=1)
    pixels = np.rint(every).astype(int).reshape(-1, 2)
    height, width = view.depth.shape
    inside = ((pixels >= 0) & (pixels < [width - 1, height - 1])).all(axis=1)
    pixels = np.where(inside[:, None], pixels, 0)
    depth = np.where(inside, view.depth[pixels[:, 1], pixels[:, 0]], np.inf).astype(np.float64)
    rays = canvas.camera.unproject(every.reshape(-1, 2))
    with np.errstate(invalid="ignore"):
        p = camera_from_part.inv @ np.where(np.isfinite(depth)[:, None], rays * (depth / rays[:, 2])[:, None], np.nan)
    p = p.reshape(len(q), n, 3)
    looks = np.stack([canvas.sampled(level, every.reshape(-1, 2))[:, 0].reshape(len(q), n) for level in range(len(_BLURS))])
    kept = np.isfinite(p).all(axis=(1, 2)) & np.isfinite(looks).all(axis=(0, 2))
    looks = looks[:, kept]
    facing = view.normal[y[chosen], x[chosen]][kept].astype(np.float64)
    return _Patches(p[kept], facing @ camera_from_part.rotation, looks - looks.mean(axis=2, keepdims=True))


def _shifted(
    patches: Sequence[_Patches], canvases: Sequence[_Canvas | None], photos: Sequence[Photo], start: Rigid
) -> Rigid:
    """Return a pose shifted across the view to where most patches are found, in the photo that has most of them."""
    shifts = np.arange(-_REACH, _REACH + 1, 2)
    shifts = np.stack(np.meshgrid(shifts, shifts), axis=-1).reshape(-1, 1, 2)
    k = int(np.argmax([0 if canvas is None else len(one.p) for one, canvas in zip(patches, canvases, strict=True)]))
    one, canvas, place = patches[k], canvases[k], photos[k].viewpoint.camera_from_world
    if canvas is None or not len(one.p):
        return start
    camera_from_part = place @ start
    p = camera_from_part @ one.p[:, ::_SPARSE]
    q = np.rint(canvas.camera.project(p.reshape(-1, 3)) + shifts)
    smooth = canvas.layers[0][..., 0]
    height, width = smooth.shape
    inside = ((q >= 0) & (q < [width, height])).all(axis=2)
    x, y = np.moveaxis(np.where(inside[..., None], q, 0).astype(np.int64), 2, 0)
    values = np.where(inside, smooth[y, x], 0.0).reshape(len(shifts), *p.shape[:2])
    look = one.looks[0][:, ::_SPARSE]
    look = look - look.mean(axis=1, keepdims=True)
    values = values - values.mean(axis=2, keepdims=True)
    alike = (values * look).sum(axis=2) / (np.linalg.norm(values, axis=2) * np.linalg.norm(look, axis=1) + 1e-9)
    best = shifts[int(np.argmax(np.maximum(alike, 0.0).sum(axis=1)))][0]
    depth = float(p[..., 2].mean())
    moved = np.array([best[0] * depth / canvas.camera.fx, best[1] * depth / canvas.camera.fy, 0.0])
    shifted = Rigid(camera_from_part.rotation, camera_from_part.translation + moved)
    return place.inv @ shifted


def _aligned(
    patches: Sequence[_Patches],
    canvases: Sequence[_Canvas | None],
    photos: Sequence[Photo],
    start: Rigid,
    freedom: Freedom,
) -> tuple[Rigid, Array, int] | None:
    """Return the pose at which patches look as they did, its covariance, and how many do; None where too few do."""
    pose = start
    for level, rounds in enumerate(_ROUNDS):
        for _ in range(rounds):
            B = freedom.at(pose)
            rows = [
                _rows(one, canvas, photo.viewpoint.camera_from_world @ pose, level)
                for one, canvas, photo in zip(patches, canvases, photos, strict=True)
                if canvas is not None and len(one.p)
            ]
            if sum(len(r.r) for r in rows) < _LEAST:
                return None
            J = np.concatenate([r.J for r in rows]) @ B
            r = np.concatenate([r.r for r in rows])
            alike = np.concatenate([r.alike for r in rows])
            own = np.mean(r**2, axis=1)
            w = np.clip((alike - _UNLIKE) / (_ALIKE - _UNLIKE), 0.0, 1.0) / (own + np.median(own) + 1e-12)
            if (w > 0).sum() < _LEAST:
                return None
            Jw = J * w[:, None, None]
            H = np.tensordot(Jw, J, ((0, 1), (0, 1)))
            g = np.einsum("pnk,pn->pk", Jw, r)
            step = np.linalg.solve(H, g.sum(axis=0))
            pose = pose @ Rigid.exp(B @ step)
            if np.quantile(np.abs(np.concatenate([r.by_px @ (B @ step) for r in rows])), 0.9) < _SETTLED_PX:
                break
    found = alike > _ALIKE
    if found.sum() < max(_LEAST, _SHARE * len(alike)):
        return None
    back = np.linalg.inv(H)
    m = float((w > 0).sum())
    S = back @ (g.T @ g) @ back * m / max(m - len(back), 1.0)
    return pose, B @ S @ B.T, int(found.sum())


@dataclass(frozen=True, slots=True, eq=False)
class _Rows:
    """Brightness r (P, n) that the patches' looks leave over, its Jacobian (P, n, 6), and how alike (P,) patches are.

    by_px (P, 2, 6): how the pose moves the patches' first points in the picture.
    """

    r: Array
    J: Array
    alike: Array
    by_px: Array


def _rows(patches: _Patches, canvas: _Canvas, camera_from_part: Rigid, level: int) -> _Rows:
    """Return what patches in view say; brightness I = a + b look + r with a and b of each patch its own."""
    n = patches.p.shape[1]
    seen = _facing(patches, camera_from_part)
    p = patches.p[seen].reshape(-1, 3)
    q, by_p = canvas.camera.project_with_jacobian(camera_from_part @ p)
    values = canvas.sampled(level, q).reshape(-1, n, 3)
    whole = np.isfinite(values).all(axis=(1, 2))
    values, look = values[whole], patches.looks[level][seen][whole]
    p, by_p = p.reshape(-1, n, 3)[whole], (by_p @ camera_from_part.rotation).reshape(-1, n, 2, 3)[whole]
    by_twist = np.concatenate([by_p, np.cross(p[:, :, None], by_p)], axis=-1)
    J = np.einsum("pni,pnik->pnk", values[..., 1:], by_twist)
    t = look / np.linalg.norm(look, axis=1, keepdims=True)
    I = values[..., 0] - values[..., 0].mean(axis=1, keepdims=True)
    along = (I * t).sum(axis=1, keepdims=True)
    r = -(I - along * t)
    J = J - J.mean(axis=1, keepdims=True)
    J = J - t[:, :, None] * np.einsum("pn,pnk->pk", t, J)[:, None]
    alike = along[:, 0] / np.maximum(np.linalg.norm(I, axis=1), 1e-9)
    return _Rows(r, J, alike, by_twist[:, 0])


def _facing(patches: _Patches, camera_from_part: Rigid) -> Mask:
    sight = camera_from_part.origin - patches.p[:, 0]
    return np.asarray((sight * patches.normal).sum(axis=1) > _FACING * np.linalg.norm(sight, axis=1))


def _inverse(covariance: Array, radius: float) -> Array:
    """Return the inverse of a covariance (6, 6) within the directions that are free."""
    D = np.repeat([1.0, radius], 3)
    return np.asarray(D[:, None] * _pinv(D[:, None] * covariance * D) * D)


def _pinv(A: Array) -> Array:
    return np.asarray(np.linalg.pinv(A, rcond=1e-9, hermitian=True))


def _root(R: Array) -> Array:
    values, axes = np.linalg.eigh(R)
    return np.asarray((axes * np.sqrt(np.maximum(values, 0.0))) @ axes.T)
