"""Photographs on the command line: their renderings, and how they are written."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable, Iterator
from typing import TYPE_CHECKING, Any

from cadcam.cli.photograph_options import SAMPLES
from cadcam.errors import BadValue

if TYPE_CHECKING:
    from cadcam.camera.aperture import Aperture
    from cadcam.camera.camera import Camera
    from cadcam.cli.dress import Dress
    from cadcam.geometry.rigid import Rigid
    from cadcam.render.cutout import Cutout
    from cadcam.render.view import Scene


class Photographs:
    """Photographs of a scene, dressed with background and sensor; an `Output` of `render`."""

    def __init__(self, scene: Scene, arguments: argparse.Namespace, dress: Dress) -> None:
        from cadcam.files.sensor import named_sensor
        from cadcam.image.sensor.sensor import Sensor
        from cadcam.render.light import named_light
        from cadcam.render.photograph import Photographer

        self._photographer = Photographer(scene, renderer=arguments.renderer, threads=arguments.threads)
        self._light = named_light(arguments.light or "hall")
        self._samples = SAMPLES if arguments.renderings is None else arguments.renderings
        self._sensor = Sensor() if arguments.sensor is None else named_sensor(arguments.sensor)
        self._arguments, self._dress = arguments, dress

    @property
    def renderings(self) -> int:
        """How many renderings a frame is the mean of."""
        from cadcam.render.samples import renderings

        return renderings(self._samples)

    def frames(
        self, camera: Camera, poses: Iterable[Rigid], *, step: Callable[[], None] = lambda: None
    ) -> Iterator[tuple[Cutout, Aperture | None]]:
        """Yield the radiance from each pose, and the opening through which it came."""
        from cadcam.render.photograph import blur_before

        for pose in poses:
            aperture = self._aperture(pose)
            blur = blur_before(self._sensor, camera, aperture)
            yield (
                self._photographer.radiance(
                    camera, pose, light=self._light, aperture=aperture, blur_px=blur, samples=self._samples, step=step
                ),
                aperture,
            )

    def empty(self, frame: tuple[Cutout, Aperture | None]) -> bool:
        """Whether no pixel sees the model."""
        return not frame[0].alpha.any()

    def write(self, path: str, frame: tuple[Cutout, Aperture | None]) -> dict[str, Any]:
        """Write the photograph."""
        from cadcam.render.photograph import behind

        cutout, aperture = frame
        said = self._dress.write_model(path, cutout, behind(self._sensor, cutout.camera))
        if aperture is not None:
            said |= {"aperture_mm": aperture.diameter_mm, "focus_mm": aperture.focus_mm}
        return said

    def _aperture(self, camera_from_world: Rigid) -> Aperture | None:
        if self._arguments.f_number is None:
            return None
        from cadcam.camera.aperture import Aperture

        for name, value in (("--focal", self._arguments.focal), ("--f-number", self._arguments.f_number)):
            if not 0 < value < float("inf"):
                raise BadValue(name, value, "a positive number")
        focus = self._arguments.focus
        if focus is None:
            low, high = self._photographer.scene.mesh.bounds
            focus = float((camera_from_world @ ((low + high) / 2))[2])
        if not focus > self._arguments.focal:
            raise BadValue(
                "the focus distance",
                f"{focus:.6g} mm",
                f"more than the focal length of {self._arguments.focal:g} mm: nothing nearer has a real picture",
            )
        return Aperture(self._arguments.focal / self._arguments.f_number, focus)
