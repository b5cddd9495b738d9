"""Photographs of a scene: light and shadows, a lens with an opening, a sensor.

What reaches a pixel is the mean over its area, over the lens' opening and over the lamps. It is taken as it is defined,
by renderings from single points of all three (Cook, Porter and Carpenter, "Distributed ray tracing", 1984): a blurred
thing before a sharp one, or behind it, covers just what it does through a real lens, and shadows soften with distance.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Array, Mask, Picture
from cadcam.camera.aperture import Aperture
from cadcam.camera.camera import Camera
from cadcam.geometry.rigid import Rigid, expect_motion
from cadcam.image.sensor.light import Blur
from cadcam.image.sensor.sensor import Sensor
from cadcam.kinds import expect
from cadcam.render import open_renderer
from cadcam.render.cores import blocks, on_all_cores
from cadcam.render.cutout import Cutout
from cadcam.render.embree import Caster
from cadcam.render.light import LIGHTS, Light
from cadcam.render.samples import pairing, sample_points
from cadcam.render.thin_lens import Pinhole, ThinLens
from cadcam.render.view import Channel, Scene, View

HALL = LIGHTS["hall"]
SAMPLES = 64
_SEEN = Channel.DEPTH | Channel.NORMAL | Channel.FACE
_BLACK = (0.0, 0.0, 0.0)
_PIXEL = 1 / 12  # px^2, the variance of a pixel's own area
_CLEAR = 1e-5  # of the depth or the model's size: how far above its face a shadow's ray starts


class Photographer:
    """Photographs of one scene, by a renderer that is made once; the colours of faces are their reflectance."""

    def __init__(self, scene: Scene, *, renderer: str = "auto", threads: int | None = None) -> None:
        self._renderer = open_renderer(scene, renderer, threads=threads)
        self._scene = scene
        self._reflectance = scene.colors[scene.paint]
        self._caster: Caster | None = None

    @property
    def scene(self) -> Scene:
        """The scene that is photographed."""
        return self._scene

    def photograph(
        self,
        camera: Camera,
        camera_from_world: Rigid,
        *,
        sensor: Sensor,
        rng: np.random.Generator,
        light: Light = HALL,
        aperture: Aperture | None = None,
        samples: int = SAMPLES,
        background: tuple[float, float, float] | npt.ArrayLike = _BLACK,
    ) -> Picture:
        """Return the picture (H, W, 3) in [0, 1] that a sensor behind the lens takes; the arguments of `radiance`.

        background: linear RGB, or a picture of the camera's size, which keeps the blur that it has.
        """
        blur = blur_before(sensor, camera, aperture)
        cutout = self.radiance(camera, camera_from_world, light=light, aperture=aperture, blur_px=blur, samples=samples)
        over = cutout.over(background) if isinstance(background, tuple) else cutout.over_photo(background)
        return behind(sensor, camera).apply(over, rng=rng)

    def radiance(
        self,
        camera: Camera,
        camera_from_world: Rigid,
        *,
        light: Light = HALL,
        aperture: Aperture | None = None,
        blur_px: float = 0.0,
        samples: int = SAMPLES,
        step: Callable[[], None] = lambda: None,
    ) -> Cutout:
        """Return the linear radiance that falls on the pixels, cut out of its background; 1 is white at exposure 1.

        aperture: by default a pinhole, sharp at every depth. blur_px: sigma of all blur but the opening's disc and the
        pixel's area, see `blur_before`. samples: renderings that are averaged, rounded up to a power of two; 16 do for
        edges, discs of blur of d px want some d^2. Whatever its number, nothing is moved, in half a shadow neither
        (`cadcam.render.samples.pairing`). step is called after each rendering.
        """
        expect(camera, "camera", Camera)
        expect_motion(camera_from_world, "camera_from_world")
        expect(light, "light", Light)
        expect(aperture, "aperture", Aperture, optional=True)
        points, lens = sample_points(samples, blur_px), ThinLens(camera, aperture)
        towards = [np.stack([lamp.direction(*at) for at in points.lamp]) for lamp in light.lamps]
        pairs = pairing(len(points))
        color = np.zeros((camera.height, camera.width, 3), np.float32)
        alpha = np.zeros((camera.height, camera.width), np.float32)
        for k, (pixel, opening) in enumerate(zip(points.pixel, points.opening, strict=True)):
            seen = lens.pinhole(camera_from_world, pixel, opening)
            self._add(color, alpha, seen, light, [to[k ^ pairs] for to in towards])
            step()
        n = np.float32(len(points))
        return Cutout(camera, np.divide(color, n, dtype=np.float32), np.divide(alpha, n, dtype=np.float32))

    def _add(self, color: Picture, alpha: Picture, pinhole: Pinhole, light: Light, towards: Sequence[Array]) -> None:
        """Add what one pinhole sees; towards: of each lamp the directions (h, w, 3) in a tile of pixels."""
        view = self._renderer.render(pinhole.camera, pinhole.camera_from_world, channels=_SEEN)
        seen = _Surface(view, pinhole, *np.nonzero(view.mask))
        irradiance = self._irradiance(seen, light, [seen.of_tile(tile) for tile in towards])
        color[seen.at] += self._reflectance[view.face[seen.at]] * irradiance[:, None]
        alpha[seen.at] += 1

    def _irradiance(self, seen: _Surface, light: Light, towards: Sequence[Array]) -> Picture:
        """Return the light (N,) on surface points, as the radiance of white.

        towards: of each lamp the direction (N, 3) of its point, for each of them.
        """
        normals, R = seen.normals, seen.pinhole.camera_from_world.rotation
        total = np.full(len(normals), light.ambient, np.float32)
        if light.flash:
            total += light.flash * np.clip(-np.einsum("ij,ij->i", normals, seen.directions), 0, 1)
        for lamp, to in zip(light.lamps, towards, strict=True):
            cosine = np.clip(np.einsum("ij,ij->i", normals, (to @ R.T).astype(np.float32)), 0, 1)
            lit = np.flatnonzero(cosine > 0)
            cosine[lit[self._shaded(seen.some(lit), to[lit])]] = 0
            total += lamp.strength * cosine
        return total

    def _shaded(self, seen: _Surface, towards: Array) -> Mask:
        """Return which surface points (N,) have the model between them and a lamp; towards (N, 3): its directions."""
        if self._caster is None:
            self._caster = Caster(self._scene.mesh)
        caster, points, normals = self._caster, seen.points, seen.world_normals
        clear = _CLEAR * max(caster.radius, seen.farthest)

        def cast(part: slice) -> Mask:
            p = points[part]
            start = p + clear * normals[part]
            reach = np.full(len(p), 4 * caster.radius)
            return np.asarray(caster.first_hit(start, towards[part], reach) >= 0)

        return np.concatenate(on_all_cores(cast, blocks(len(points))))


@dataclass(frozen=True, slots=True, eq=False)
class _Surface:
    """The surface points that N pixels of a pinhole's view see; row, column (N,): the pixels."""

    view: View
    pinhole: Pinhole
    row: npt.NDArray[np.intp]
    column: npt.NDArray[np.intp]

    @property
    def at(self) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
        """Return the pixels as an index."""
        return self.row, self.column

    def some(self, which: npt.NDArray[np.intp]) -> _Surface:
        """Return some of the points."""
        return _Surface(self.view, self.pinhole, self.row[which], self.column[which])

    def of_tile(self, tile: Array) -> Array:
        """Return the values (N, ...) of the points' pixels in a tile (h, w, ...) that is repeated over the picture."""
        return np.asarray(tile[self.row % tile.shape[0], self.column % tile.shape[1]])

    @property
    def normals(self) -> Picture:
        """Return the unit normals (N, 3) in the pinhole's frame."""
        return np.asarray(self.view.normal[self.at])

    @property
    def world_normals(self) -> Picture:
        """Return the unit normals (N, 3) in the world."""
        return np.asarray(self.normals @ self.pinhole.camera_from_world.rotation.astype(np.float32))

    @property
    def directions(self) -> Picture:
        """Return the unit directions (N, 3) in which the pixels look, in the pinhole's frame."""
        return np.asarray(self.pinhole.directions[self.at], np.float32)

    @property
    def points(self) -> Array:
        """Return the points (N, 3) in the world."""
        z = self.view.depth[self.at].astype(np.float64)[:, None]
        return self.pinhole.camera_from_world.inv @ np.concatenate([self.pinhole.plane[self.at] * z, z], axis=1)

    @property
    def farthest(self) -> float:
        """Return the largest depth of a point, which is known to 1e-6 of it; 0 for none."""
        return float(self.view.depth[self.at].max(initial=0))


def blur_before(sensor: Sensor, camera: Camera, aperture: Aperture | None) -> float:
    """Return the sigma in px of the blur that a radiance behind a lens needs beside disc and pixel for a sensor's.

    The sensor's own, which stands for diffraction, lens and pixel together, less the pixel's 1/12 px^2; no less than
    the diffraction of the opening. It is taken with the light, since kernels of pixels cannot blur by half a pixel.
    """
    own = 0.0 if sensor.blur is None else sensor.blur.sigma_px
    least = 0.0 if aperture is None else aperture.diffraction_px(camera)
    return float(max(np.sqrt(max(own**2 - _PIXEL, 0.0)), least))


def behind(sensor: Sensor, camera: Camera) -> Sensor:
    """Return what a sensor has still to do to a radiance that was blurred as `blur_before` says.

    Its natural vignetting becomes that of the camera, about the principal point.
    """
    disc = 0.0 if sensor.blur is None else sensor.blur.defocus_px
    vignetting = sensor.vignetting
    if vignetting is not None and vignetting.focal_px:
        off = camera.principal_point - (np.array(camera.size) - 1) / 2
        vignetting = replace(vignetting, focal_px=camera.fx, offset_px=(float(off[0]), float(off[1])))
    return replace(sensor, blur=Blur(0.0, disc) if disc else None, vignetting=vignetting)
