"""Photographs of a scene: light and shadows, a lens with an opening, a sensor.

What reaches a pixel is the mean over its area, over the lens' opening and over the lamps. It is taken as it is defined,
by renderings from single points of all three (Cook, Porter and Carpenter, "Distributed ray tracing", 1984): a blurred
thing before a sharp one, or behind it, covers just what it does through a real lens, and shadows soften with distance.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias, TypeVar

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Array, Mask, Picture
from cadcam.camera.aperture import Aperture
from cadcam.camera.camera import Camera
from cadcam.camera.perspective import direction
from cadcam.cores import blocks, on_cores
from cadcam.geometry.rigid import Rigid, expect_motion
from cadcam.image.sensor.light import Blur
from cadcam.image.sensor.sensor import Sensor
from cadcam.kinds import expect
from cadcam.render import open_renderer
from cadcam.render.caster import Caster
from cadcam.render.cutout import Cutout
from cadcam.render.light import LIGHTS, Light
from cadcam.render.samples import pairing, sample_points
from cadcam.render.thin_lens import Pinhole, ThinLens
from cadcam.render.view import Channel, Scene, View

HALL = LIGHTS["hall"]
SAMPLES = 64
_SEEN = Channel.DEPTH | Channel.NORMAL | Channel.FACE
_BLACK = (0.0, 0.0, 0.0)
_PIXEL = 1 / 12  # px^2, the variance of a pixel's own area
_TOGETHER = 1 << 20  # pixels that are lit at a time
_CLEAR = 1e-5  # of the depth or the model's size: how far above its face a shadow's ray starts

_At: TypeAlias = tuple[npt.NDArray[np.intp], ...]
_Tile = TypeVar("_Tile", Array, Picture)  # directions (h, w, 3), or those of single pixels


class Photographer:
    """Photographs of one scene, by a renderer that is made once; the colours of faces are their reflectance."""

    def __init__(self, scene: Scene, *, renderer: str = "auto", threads: int | None = None) -> None:
        self._renderer = open_renderer(scene, renderer, threads=threads)
        self._scene = scene
        self._reflectance = scene.colors[scene.paint]
        self._caster: Caster | None = None

    def __getstate__(self) -> dict[str, object]:
        return {**self.__dict__, "_caster": None}  # a copy, in another process, say, makes its own

    def __repr__(self) -> str:
        return f"Photographer({self._scene!r}, by {type(self._renderer).__name__})"

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
        del cutout  # before the sensor needs as much memory
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
        step: Callable[[], None] | None = None,
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
            if step:
                step()
        for total in (color, alpha):
            total /= np.float32(len(points))
        return Cutout(camera, color, alpha)

    def _add(self, color: Picture, alpha: Picture, seen: Pinhole, light: Light, towards: Sequence[Array]) -> None:
        """Add what one pinhole sees; towards: of each lamp the directions (h, w, 3) in a tile of pixels.

        Row by row of blocks, so that next to nothing but the view is held of the whole picture.
        """
        view = self._renderer.render(seen.camera, seen.camera_from_world, channels=_SEEN)
        R = seen.camera_from_world.rotation
        parts = [_Part.of(view, rows, towards, R) for rows in blocks(len(alpha), max(1, _TOGETHER // alpha.shape[1]))]
        farthest = [max(part.farthest[i] for part in parts) for i in range(len(towards))]
        for part in parts:
            there, at = part.rows, part.at(view)
            irradiance = self._irradiance(view, seen, part, at, light, towards, farthest)
            color[there][at] += self._reflectance[view.face[there][at]] * irradiance[:, None]
            alpha[there][at] += 1

    def _irradiance(
        self,
        view: View,
        seen: Pinhole,
        part: _Part,
        at: _At,
        light: Light,
        towards: Sequence[Array],
        farthest: list[float],
    ) -> Picture:
        """Return the light (N,) on the surface points that the pixels `at` of a part see, as the radiance of white.

        farthest: of each lamp the largest depth of a point that faces it.
        """
        rows, R = part.rows, seen.camera_from_world.rotation
        normal, plane, depth = view.normal[rows][at], seen.beside.points(rows), view.depth[rows]
        total = np.full(len(normal), light.ambient, np.float32)
        if light.flash:
            directions = direction(plane[at]).astype(np.float32)
            total += light.flash * np.clip(-np.einsum("ij,ij->i", normal, directions), 0, 1)
        for i, lamp in enumerate(light.lamps):
            cosine = part.cosines[i].copy()
            lit = np.flatnonzero(cosine > 0)
            where = tuple(k[lit] for k in at)
            z = depth[where].astype(np.float64)[:, None]
            points = seen.camera_from_world.inv @ np.concatenate([plane[where] * z, z], axis=1)
            to = part.towards(towards[i], where)
            dark = self._shaded(points, normal[lit] @ R.astype(np.float32), to, farthest[i])
            cosine[lit[dark]] = 0
            total += lamp.strength * cosine
        return total

    def _shaded(self, points: Array, normals: Picture, towards: Array, farthest: float) -> Mask:
        """Return which points (N, 3) with normals (N, 3) in the world have the model between them and a lamp.

        towards (N, 3): the unit direction of the lamp from each; farthest: the largest depth of a point, which is known
        to 1e-6 of it.
        """
        if self._caster is None:
            self._caster = Caster(self._scene.mesh)
        caster = self._caster
        clear = _CLEAR * max(caster.radius, farthest)

        def cast(part: slice) -> Mask:
            p = points[part]
            start = p + clear * normals[part]
            reach = np.full(len(p), 4 * caster.radius)
            return np.asarray(caster.first_hit(start, towards[part], reach) >= 0)

        return np.concatenate(on_cores(cast, blocks(len(points))))


@dataclass(frozen=True, slots=True, eq=False)
class _Part:
    """Some rows of a view: of each lamp the cosines (N,) at the points seen there, and the depth of the last lit."""

    rows: slice
    cosines: tuple[Picture, ...]
    farthest: tuple[float, ...]

    @classmethod
    def of(cls, view: View, rows: slice, towards: Sequence[Array], R: Array) -> _Part:
        """Return a part; towards: of each lamp a tile (h, w, 3) of directions in the world; R: camera from world."""
        part = cls(rows, (), ())
        at = part.at(view)
        normal, depth = view.normal[rows][at], view.depth[rows][at]
        cosines, farthest = [], []
        for tile in towards:
            to = part.towards((tile @ R.T).astype(np.float32), at)
            cosines.append(np.clip(np.einsum("ij,ij->i", normal, to), 0, 1))
            farthest.append(float(depth[cosines[-1] > 0].max(initial=0)))
        return cls(rows, tuple(cosines), tuple(farthest))

    def at(self, view: View) -> _At:
        """Return the rows, from the first of the part, and columns of the pixels that see anything."""
        return np.nonzero(view.face[self.rows] >= 0)

    def towards(self, tile: _Tile, at: _At) -> _Tile:
        """Return the direction (N, 3) to a lamp's point for each of these pixels."""
        row = at[0] + self.rows.start
        found: _Tile = tile[row % tile.shape[0], at[1] % tile.shape[1]]
        return found


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
