"""Photographs on the command line: light with shadows, and a lens with an opening."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable, Iterator
from typing import TYPE_CHECKING, Any

from cadcam.cli.arguments import given, real, refuse, whole
from cadcam.errors import BadValue

if TYPE_CHECKING:
    from cadcam.camera.aperture import Aperture
    from cadcam.camera.camera import Camera
    from cadcam.cli.looks import Dress
    from cadcam.geometry.rigid import Rigid
    from cadcam.render.cutout import Cutout
    from cadcam.render.view import Scene

LIGHTS = ("hall", "sun", "ring", "even")
WALL = "#808080"  # behind a photograph, where nothing else is asked for
_SAMPLES = 64


def add_photograph_options(parser: argparse.ArgumentParser) -> None:
    """Add light and lens."""
    group = parser.add_argument_group(
        "photograph", "what a camera would really take, in linear light; with --sensor, down to its grey levels"
    )
    group.add_argument(
        "--light",
        choices=LIGHTS,
        help="hall (lamps under the roof, soft shadows; the default with --f-number), sun (hard shadows), ring (flash "
        "round the lens), even; +Z is up",
    )
    group.add_argument(
        "--focal", type=real, metavar="MM", help="focal length, for --f-number; lens distortion is the camera file's"
    )
    group.add_argument("--f-number", type=real, metavar="N", help="aperture of the lens: blurs what is out of focus")
    group.add_argument(
        "--focus", type=real, metavar="MM", help="distance in focus, from the lens (default: the middle of the model)"
    )
    group.add_argument(
        "--renderings",
        type=whole,
        metavar="N",
        help=f"renderings that make up the photograph (default: {_SAMPLES}; more for much blur, fewer for speed)",
    )


def is_photograph(arguments: argparse.Namespace) -> bool:
    """Whether light or lens were asked for."""
    return arguments.light is not None or arguments.f_number is not None


def check_photograph_options(arguments: argparse.Namespace) -> None:
    """Refuse options that would be ignored, and a lens that is half specified, before the work starts."""
    photograph = ("--light", "--f-number", "--focal", "--focus", "--renderings")
    if arguments.channel != "shaded":
        here = f"with --channel {arguments.channel}"
        refuse(arguments, *photograph, why=here, expected="--channel shaded, or leave it out")
    if arguments.f_number is None:
        all_of_it = "--f-number N too: blur is decided by the opening"
        refuse(arguments, "--focal", "--focus", why="without --f-number", expected=all_of_it)
    elif arguments.focal is None:
        raise BadValue("--f-number", "given without --focal", "both: the opening is focal length by f-number")
    if not is_photograph(arguments):
        one = "one of them: else nothing is photographed"
        refuse(arguments, "--renderings", why="without --light or --f-number", expected=one)
    for asked in given(arguments, *photograph)[:1]:
        neither = "one of them: photographs have neither looks nor drawn edges"
        refuse(arguments, "--look", "--edges", why=f"beside {asked}", expected=neither)


class Photographs:
    """Photographs of a scene, dressed with background and sensor; an `Output` of `render`."""

    def __init__(self, scene: Scene, arguments: argparse.Namespace, dress: Dress) -> None:
        from cadcam.files.sensor import named_sensor
        from cadcam.image.sensor.sensor import Sensor
        from cadcam.render.light import named_light
        from cadcam.render.photograph import Photographer

        self._photographer = Photographer(scene, renderer=arguments.renderer, threads=arguments.threads)
        self._light = named_light(arguments.light or "hall")
        self._samples = _SAMPLES if arguments.renderings is None else arguments.renderings
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
