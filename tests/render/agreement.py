"""Whether a view shows what brute force says is there: the one judge of all renderers.

A renderer may see another face than the truth at a pixel centre only if an outline passes within its bound, or if two
faces are too close in depth there for it to tell. Distances are measured in the picture, through the lens, from the
edges of those two faces alone: among small triangles every pixel is near some edge.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cadcam.camera.camera import Camera
from cadcam.camera.lens import Ideal
from cadcam.geometry.rigid import Rigid
from cadcam.render.view import Look, Scene, View

from .coverage import brute_force

FLOAT = 2.0**-23  # one step of float32, relative
DEPTH = 1e-6  # of itself: eight steps of float32; what two renderers may differ by is twice that
SAMPLES, ROUNDS = 25, 9  # of an edge; each round looks at 2/24 of the one before: 2e-10 of the edge in the end


@dataclass(frozen=True, slots=True)
class Bound:
    """How closely a renderer places outlines, px, and tells depths apart: a share of the depth, or mm."""

    px: float
    depth_share: float
    depth_mm: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """What each pixel centre of a view sees: face (H, W), -1 for none, and z-depth, inf for none."""

    scene: Scene
    camera: Camera
    pose: Rigid
    face: np.ndarray
    depth: np.ndarray

    @classmethod
    def of(cls, scene: Scene, camera: Camera, pose: Rigid) -> Truth:
        """Return what brute force in double precision finds."""
        face, w, _ = brute_force(scene.mesh.vertices, scene.mesh.faces, camera, pose, number=np.float64)
        with np.errstate(divide="ignore"):
            return cls(scene, camera, pose, face, 1 / w)

    def corners(self, face: np.ndarray) -> np.ndarray:
        """Return the corners (N, 3, 3) of faces in the camera frame; NaN for face -1."""
        p = self.pose @ self.scene.mesh.vertices[self.scene.mesh.faces[face]]
        return np.where(face[:, None, None] < 0, np.nan, p)


def bound_of(renderer: str, truth: Truth) -> Bound:
    """Return what a renderer says of itself.

    raster decides in double precision, and tells depths apart as float32 does. ray computes in float32 around the
    model. gl has OpenGL's grid of 1/256 px for cameras without distortion, single precision for others, and a depth
    buffer of 24 bits over the scene's depth.
    """
    diagonal = float(np.linalg.norm(truth.scene.mesh.size_mm))
    if renderer == "raster":
        return Bound(0.0, 4 * FLOAT)
    if renderer == "ray":
        return Bound(1e-3, 4 * FLOAT, 2e-7 * diagonal)
    return Bound(2 / 256 if isinstance(truth.camera.lens, Ideal) else 1e-3, 4 * FLOAT, 2e-7 * diagonal)


def check(view: View, truth: Truth, bound: Bound) -> int:
    """Check every layer of a view; return at how many pixel centres it sees another face than the truth."""
    same = (view.face == truth.face) & (truth.face >= 0)
    assert same.mean() > 0.005, "the model is in the picture"
    check_faces(view, truth, bound)
    depth = np.abs(view.depth[same] / truth.depth[same] - 1).max()
    assert depth < DEPTH, f"depth is off by {depth:.1e} of itself"
    assert np.isinf(view.depth[view.face < 0]).all()
    assert np.array_equal(view.coverage, view.face >= 0), "one sample a pixel: all or nothing"
    part = truth.scene.mesh.part
    assert np.array_equal(view.part, np.where(view.face < 0, -1, part[view.face])), "parts are those of the faces"
    normal = towards_camera(truth, same)
    assert np.abs(view.normal[same] - normal).max() < 1e-5
    assert np.abs(view.image[same] - lit(truth, same, normal)).max() < 1e-5
    return int(np.sum(view.face != truth.face))


def check_faces(view: View, truth: Truth, bound: Bound) -> None:
    """Check that another face than the truth is seen only where an outline passes, or where two are equally deep."""
    at = np.nonzero(view.face != truth.face)
    seen, true, q = view.face[at], truth.face[at], np.stack(at[::-1], axis=1).astype(float)
    close_seen, close_true = (outline_distance(truth, f, q) <= bound.px for f in (seen, true))
    covers = covered(truth, seen, q)
    depth, true_depth = view.depth[at].astype(float), truth.depth[at]
    there = (seen < 0) | covers | close_seen
    as_deep = true_depth * (1 + bound.depth_share) + bound.depth_mm
    right = there & (close_true | ((close_seen | covers) & (depth <= as_deep)))
    wrong = np.flatnonzero(~right)
    if len(wrong):
        k = wrong[0]
        raise AssertionError(
            f"{len(wrong)} of {view.face.size} pixels see a face that is not there, farther than {bound.px} px from an "
            f"outline: at {q[k]} face {seen[k]} at {depth[k]:.6f} mm, not {true[k]} at {true_depth[k]:.6f} mm"
        )


def covered(truth: Truth, face: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Return which pixels q (N, 2) look at their face (N,)."""
    d, (a, b, c) = truth.camera.unproject(q), np.moveaxis(truth.corners(face), 1, 0)
    volumes = np.array([np.einsum("ni,ni->n", d, np.cross(*pair)) for pair in ((b, c), (c, a), (a, b))])
    return np.asarray((volumes > 0).all(axis=0) | (volumes < 0).all(axis=0))


def outline_distance(truth: Truth, face: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Return how far pixels q (N, 2) are from the image of the outline of their face (N,), px; inf for face -1."""
    a = truth.corners(face)
    step = np.roll(a, -1, axis=1) - a
    low, high = np.zeros(a.shape[:2]), np.ones(a.shape[:2])
    for _ in range(ROUNDS):
        t = low[..., None] + (high - low)[..., None] * np.linspace(0, 1, SAMPLES)
        image = truth.camera.project(a[:, :, None] + t[..., None] * step[:, :, None])
        distance = np.linalg.norm(image - q[:, None, None], axis=-1)
        distance = np.where(np.isnan(distance), np.inf, distance)  # behind the camera, or beyond the lens
        nearest = distance.argmin(axis=2)
        low, high = (np.take_along_axis(t, _beside(nearest, k), axis=2)[..., 0] for k in (-1, 1))
    return np.asarray(distance.min(axis=(1, 2), initial=np.inf))


def _beside(sample: np.ndarray, k: int) -> np.ndarray:
    return np.clip(sample + k, 0, SAMPLES - 1)[..., None]


def towards_camera(truth: Truth, where: np.ndarray) -> np.ndarray:
    """Return the normals (N, 3) of the true faces at some pixels, camera frame, on the side that is seen."""
    p = truth.corners(truth.face[where])
    n = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    n /= np.linalg.norm(n, axis=1)[:, None]
    return n * -np.sign(np.einsum("ni,ni->n", n, p[:, 0]))[:, None]


def lit(truth: Truth, where: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Return RGB (N, 3) of the true faces at some pixels under the default lights, by Lambert's law."""
    look, q = Look(), np.stack(np.nonzero(where)[::-1], axis=1)
    light = look.ambient - look.head * np.einsum("ni,ni->n", normal, truth.camera.unproject(q))
    for strength, towards in ((look.fill, look.fill_from), (look.back, look.back_from)):
        light += strength * np.clip(normal @ towards / np.linalg.norm(towards), 0, None)
    color = truth.scene.colors[truth.scene.mesh.part[truth.face[where]]]
    return np.clip(color * light[:, None], 0, 1)
