"""Ray casting through the exact lens: one ray per pixel centre, nothing about the camera approximated.

Embree, or without it the core, finds the face, in float32 with rays that start close to the model; depth and normal are
then those of that face's plane in float64. At an outline, or between coincident faces, a pixel centre within about 1e-7
of the model's diagonal of the border may fall on either side.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Array, Ids, Picture
from cadcam.camera.camera import Camera
from cadcam.cores import blocks, on_cores
from cadcam.geometry.rigid import Rigid
from cadcam.render.caster import Caster
from cadcam.render.lens_tables import slopes
from cadcam.render.memory import check_memory
from cadcam.render.shade import shade
from cadcam.render.view import (
    PLAIN,
    Channel,
    Look,
    Scene,
    View,
    expect_poses,
    expect_view,
    layers_of,
    with_image,
    with_rgb,
)

_BAND = 1 << 17  # rays at a time: about 20 MB of temporaries per core, whatever the picture's size
_CACHED = 1 << 14  # pixels unprojected at a time
_KEPT = 1 << 23  # rays of a camera are kept up to this many (200 MB)
_RAY_BYTES = 24


class RayRenderer:
    """Renders a scene by casting rays; implements the `Renderer` protocol."""

    name = "ray"

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self._caster = Caster(scene.mesh)
        self._normals = scene.mesh.face_normals
        self._anchor = scene.mesh.vertices[scene.mesh.faces[:, 0]]
        self._rays: dict[tuple[Any, ...], Array] = {}

    def __reduce__(self) -> tuple[type[RayRenderer], tuple[Scene]]:
        return type(self), (self._scene,)

    def __repr__(self) -> str:
        return f"RayRenderer({self._scene!r})"

    @property
    def scene(self) -> Scene:
        """The scene it was made from."""
        return self._scene

    def render(
        self,
        camera: Camera,
        camera_from_world: Rigid,
        *,
        channels: Channel = Channel.ALL,
        look: Look = PLAIN,
    ) -> View:
        """Return the view; see `Renderer.render`."""
        expect_view(camera, [camera_from_world], channels, look)
        pixels, wanted = camera.width * camera.height, layers_of(with_image(channels))
        pixel_bytes = sum(layer.pixel_bytes for layer in wanted.values()) + _RAY_BYTES * (pixels <= _KEPT)
        check_memory(pixels * pixel_bytes, f"a view of {camera.width} x {camera.height} px")
        layers: dict[str, npt.NDArray[Any]] = {
            name: np.full(layer.shape(camera), look.background if name == "image" else layer.background, layer.dtype)
            for name, layer in wanted.items()
        }
        depths = (camera_from_world @ self._scene.mesh.vertices)[:, 2][self._scene.mesh.faces]
        span = np.stack([depths.min(axis=1), depths.max(axis=1)], axis=1)
        self._keep_rays(camera)

        def fill(band: slice) -> None:
            hits = _Hits(self, self._directions(camera, band), camera_from_world, span)
            _store(layers, band, hits, look, centred=look.supersampling == 1)
            if look.supersampling > 1 and "image" in layers:
                self._supersample(layers, band, camera, camera_from_world, span, look)

        on_cores(fill, blocks(camera.height, max(1, _BAND // camera.width)))
        return View(camera, camera_from_world, with_rgb(layers, channels))

    def render_batch(
        self,
        camera: Camera,
        poses: Iterable[Rigid],
        *,
        channels: Channel = Channel.ALL,
        look: Look = PLAIN,
    ) -> Iterator[View]:
        """Yield a view for each camera_from_world; see `Renderer.render_batch`."""
        expect_poses(poses)
        for pose in poses:
            yield self.render(camera, pose, channels=channels, look=look)

    def _supersample(
        self, layers: dict[str, npt.NDArray[Any]], band: slice, camera: Camera, pose: Rigid, span: Array, look: Look
    ) -> None:
        """Average the image and coverage of a band over n x n rays per pixel.

        The rays around a centre are extrapolated from the lens' exact ones: off by under 1e-3 px, for the image only.
        """
        n = look.supersampling
        image, coverage = np.zeros_like(layers["image"][band]), np.zeros_like(layers["coverage"][band])
        centre, per_x, per_y = self._ray_field(camera, band)
        for i, j in np.ndindex(n, n):
            rays = centre + ((i + 0.5) / n - 0.5) * per_x + ((j + 0.5) / n - 0.5) * per_y
            rays[~(rays[..., 2] > 0)] = np.nan  # beyond 90 degrees nothing is seen
            rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
            one = {"image": np.zeros_like(image), "coverage": np.zeros_like(coverage)}
            one["image"][:] = look.background
            _store(one, slice(None), _Hits(self, rays, pose, span), look, centred=True)
            image += one["image"]
            coverage += one["coverage"]
        layers["image"][band], layers["coverage"][band] = image / n**2, coverage / n**2

    def _ray_field(self, camera: Camera, band: slice) -> tuple[Array, Array, Array]:
        """Return the rays of a band and their change per px along x and y, each (h, W, 3)."""
        wide = slice(max(band.start - 1, 0), min(band.stop + 1, camera.height))
        rays = self._directions(camera, wide)
        inner = slice(band.start - wide.start, band.stop - wide.start)
        per_x, per_y = slopes(rays)
        return rays[inner], per_x[inner], per_y[inner]

    def _keep_rays(self, camera: Camera) -> None:
        """Keep the rays of the last camera, for batches of poses; if too many, they are computed again band by band."""
        key = (camera.size, camera.K.tobytes(), camera.lens)
        if key not in self._rays:
            few = camera.width * camera.height <= _KEPT
            self._rays = {key: _unproject(camera, slice(0, camera.height))} if few else {}

    def _directions(self, camera: Camera, band: slice) -> Array:
        """Return the rays of a band of pixel rows."""
        for rays in self._rays.values():
            return rays[band]
        return _unproject(camera, band)


class _Hits:
    """The hits of the rays (h, w, 3) of a band: flat indices of the pixels, faces, rays, normals, depths."""

    def __init__(self, renderer: RayRenderer, rays: Array, camera_from_world: Rigid, span: Array) -> None:
        scene, caster = renderer.scene, renderer._caster
        self.shape = rays.shape[:2]
        self._scene = scene
        R, eye = camera_from_world.rotation, camera_from_world.origin
        flat = rays.reshape(-1, 3)
        to_center = caster.center - eye
        along = flat @ (R @ to_center)
        off2 = to_center @ to_center - along**2  # squared distance of each ray from the centre
        r = caster.radius * (1 + 1e-6)
        candidates = np.flatnonzero((off2 <= r * r) & (along > -r))
        start = np.maximum(along[candidates] - r, 0.0)
        directions = flat[candidates] @ R
        faces = caster.first_hit(eye + start[:, None] * directions, directions, np.full(len(start), 4 * r))
        met = faces >= 0
        self.pixel, self.face = candidates[met], faces[met]
        self.ray, directions = flat[self.pixel], directions[met]
        self.part: Ids = scene.mesh.part[self.face]
        normal = renderer._normals[self.face]
        facing = np.einsum("ij,ij->i", normal, directions)
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = np.einsum("ij,ij->i", normal, renderer._anchor[self.face] - eye) / facing
        # a face seen edge-on has no stable plane: its depth is clamped to those of its corners
        low, high = span[self.face, 0], span[self.face, 1]
        self.depth = np.clip(np.where(np.isfinite(distance), distance * self.ray[:, 2], low), low, high)
        self.normal: Picture = ((normal * -np.copysign(1.0, facing)[:, None]) @ R.T).astype(np.float32)

    def colors(self, look: Look) -> Picture:
        """Return the shaded RGB of the hit pixels."""
        return shade(
            self.normal, (-self.ray).astype(np.float32), self._scene.colors[self._scene.paint[self.face]], look
        )


def _store(layers: dict[str, npt.NDArray[Any]], band: slice, hits: _Hits, look: Look, *, centred: bool) -> None:
    """Write the hits into a band of the layers; the image only if it gets no other rays."""
    at = np.unravel_index(hits.pixel, hits.shape)
    for name in ("depth", "normal", "part", "face"):
        if name in layers:
            layers[name][band][at] = getattr(hits, name)
    if centred and "image" in layers:
        layers["image"][band][at] = hits.colors(look)
        layers["coverage"][band][at] = 1.0


def _unproject(camera: Camera, band: slice) -> Array:
    """Return the unit rays (h, W, 3) of the centres of some pixel rows; few at a time, to stay in the cache."""
    rays = np.zeros((band.stop - band.start, camera.width, 3))
    x = np.arange(camera.width, dtype=np.float64)
    rows = max(1, _CACHED // camera.width)
    for top in range(0, len(rays), rows):
        y = np.arange(band.start + top, min(band.start + top + rows, band.stop), dtype=np.float64)
        rays[top : top + rows] = camera.unproject(np.stack(np.meshgrid(x, y), axis=-1))
    return rays
