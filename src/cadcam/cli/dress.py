"""What is added to a shaded picture and around it: edge lines, background, sensor; and how it is written."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cadcam.cli.arguments import color
from cadcam.cli.photograph_options import WALL, is_photograph
from cadcam.cli.sensors import generator
from cadcam.cli.wires import INK, style_of
from cadcam.errors import BadValue

if TYPE_CHECKING:
    from cadcam.arrays import Picture
    from cadcam.image.sensor.sensor import Sensor
    from cadcam.render.cutout import Cutout
    from cadcam.render.overlay import LineStyle
    from cadcam.render.view import Scene, View

Color = tuple[float, float, float]


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
