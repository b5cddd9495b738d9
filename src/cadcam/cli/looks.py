"""Options of shaded pictures: light, colours of parts, edge lines, background."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cadcam.cli.arguments import color, named_color, refuse
from cadcam.cli.photographs import WALL, add_photograph_options, check_photograph_options, is_photograph
from cadcam.cli.sensors import add_sensor_options, generator
from cadcam.cli.wires import INK, draws_lines, scene_of, scene_without_edges, style_of
from cadcam.errors import BadValue

if TYPE_CHECKING:
    from cadcam.arrays import Picture
    from cadcam.cad.mesh import Mesh
    from cadcam.image.sensor.sensor import Sensor
    from cadcam.render.cutout import Cutout
    from cadcam.render.overlay import LineStyle
    from cadcam.render.view import Look, Scene, View

Color = tuple[float, float, float]

NAMES = ("default", "inspection", "flat")
_SAMPLES = 3  # per pixel and axis: for smooth outlines


def add_look_options(parser: argparse.ArgumentParser) -> None:
    """Add the options for the look of the shaded picture."""
    group = parser.add_argument_group("looks of the shaded picture")
    group.add_argument(
        "--look",
        choices=NAMES,
        help="light: default (three lights), inspection (even, no face dark), flat (each part in its colour)",
    )
    group.add_argument(
        "--part-color",
        type=named_color,
        action="append",
        metavar="NAME=#rrggbb",
        help="colour of a part, or of parts by a pattern such as 'bolt*'; may be repeated, the last one wins",
    )
    group.add_argument("--edges", action="store_true", help="soft edge lines on it; see lines below")
    group.add_argument(
        "--background",
        metavar="COLOUR|PHOTO",
        help="'#rrggbb', white (default), black, or a photo of the camera's size",
    )
    group.add_argument("--transparent", action="store_true", help="no background at all: .png with alpha")
    add_photograph_options(parser)
    add_sensor_options(parser)


def check_look_options(arguments: argparse.Namespace) -> None:
    """Refuse options without effect, before the work starts."""
    look = ("--look", "--edges", "--background", "--transparent", "--sensor")
    here = f"with --channel {arguments.channel}"
    if arguments.channel != "shaded":
        refuse(arguments, *look, why=here, expected="--channel shaded, or leave it out")
    if arguments.channel not in ("shaded", "parts"):
        refuse(arguments, "--part-color", why=here, expected="--channel shaded or parts")
    if arguments.sensor is None:
        refuse(arguments, "--seed", why="without --sensor", expected="both: nothing else here is left to chance")
    if arguments.transparent:
        beside = "beside --transparent"
        refuse(arguments, "--background", why=beside, expected="one of them")
        refuse(arguments, "--sensor", why=beside, expected="one of them: a camera sees some background")
    if arguments.transparent and not arguments.output.lower().endswith(".png"):
        raise BadValue("--transparent", f"given for {arguments.output}", "an output .png: no other format has alpha")
    check_photograph_options(arguments)


def look_of(arguments: argparse.Namespace) -> Look:
    """Return the look to render with: on black, because `Dress` adds the background."""
    from cadcam.render.looks import named_look

    look = named_look(arguments.look or "default")
    return replace(look, supersampling=_SAMPLES, background=(0.0, 0.0, 0.0))


def scene_as_asked(arguments: argparse.Namespace, mesh: Mesh) -> Scene:
    """Return the scene in the requested colours, with its edges where they are drawn: finding them takes time."""
    from cadcam.render.looks import repaint

    scene = scene_of(arguments, mesh) if draws_lines(arguments) else scene_without_edges(mesh)
    return repaint(scene, arguments.part_color or ())


class Dress:
    """What is added around and on the shaded model, and how it is written to a file."""

    def __init__(self, arguments: argparse.Namespace, scene: Scene) -> None:
        from cadcam.files.sensor import named_sensor
        from cadcam.render.lines.visible import LineDrawer

        self._arguments = arguments
        usual = WALL if is_photograph(arguments) else "white"
        self._background = None if arguments.transparent else background(arguments.background or usual)
        self._drawer = LineDrawer(scene) if arguments.edges else None
        self._sensor = None if arguments.sensor is None else named_sensor(arguments.sensor)

    def write(self, path: str, view: View) -> dict[str, Any]:
        """Write the picture; return the number of pixels that show the model."""
        from cadcam.render.cutout import Cutout
        from cadcam.render.lines.wireframe import LineOptions

        model = Cutout.of(view)
        if self._drawer is not None:
            options = LineOptions(hidden=self._arguments.hidden)
            wireframe = self._drawer.draw(view.camera, view.camera_from_world, options=options)
            model = model.with_lines(wireframe, style=_soft(self._arguments))
        return self.write_model(path, model, self._sensor)

    def write_model(self, path: str, model: Cutout, sensor: Sensor | None) -> dict[str, Any]:
        """Write a model on its background as imaged by the sensor; return the number of pixels that show the model.

        size_px: the picture's size, where the sensor makes it another than the camera's.
        """
        import numpy as np

        from cadcam.image.picture import write_picture

        said: dict[str, Any] = {"seen_pixels": int(np.count_nonzero(model.alpha))}
        if self._background is None:
            write_picture(path, np.clip(model.straight, 0, 1), alpha=model.alpha)
        else:
            behind_it = self._background
            picture = model.over(behind_it) if isinstance(behind_it, tuple) else model.over_photo(behind_it)
            if sensor is not None:  # each file has noise of its own
                picture = sensor.apply(picture, rng=generator(self._arguments.seed or 0, path))
            write_picture(path, picture)
            if picture.shape[1::-1] != model.camera.size:  # a sensor of oblong pixels
                said["size_px"] = list(picture.shape[1::-1])
        return said


def background(text: str) -> Color | Picture:
    """Return the colour given by a text, or the photo in the file of this name."""
    try:
        return color(text)
    except argparse.ArgumentTypeError as error:
        if text.startswith("#") or not (Path(text).suffix or Path(text).exists()):
            raise BadValue("--background", repr(text), "a colour such as '#20262e', or a photo") from error
    from cadcam.image.camera_picture import read_camera_picture

    return read_camera_picture(text)


def _soft(arguments: argparse.Namespace) -> LineStyle:
    """Return the style of edge lines on a shaded picture: as requested, but not wholly opaque."""
    from cadcam.render.cutout import SOFT

    style = style_of(arguments, color=INK)
    return replace(style, opacity=SOFT.opacity, hidden_opacity=SOFT.hidden_opacity)
