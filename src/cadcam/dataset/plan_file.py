"""The plan file: YAML, every key optional; options have the same names, without the unit.

    count: 1000
    seed: 1
    camera: camera.json             # or: size: [640, 480] and view_angle_deg: 40 (over the shorter side)
    focal_jitter_percent: 0.5       # sigma; also center_jitter_px
    seen_from: above:70             # any, above, above:DEG, X,Y,Z:DEG: towards the camera, in the part's axes
    up: [0, 0, 1]                   # stands at most roll_deg from upright in the picture
    roll_deg: 20
    fill: [0.4, 0.9]                # the part's diameter by the shorter side, to 2; or: distance_mm: [800, 1500]
    off_center: 0.1                 # of the shorter side
    poses: poses.csv                # camera_from_part one by one, in place of seen_from, up, roll_deg, fill ...
    head: [0.1, 0.5]                # lights: at the camera; also distant (two, from anywhere) and ambient
    backgrounds: [plain, noise, photos/]
    occluders: [0, 3]
    occluder_shapes: [box, cylinder, clamp.stl]
    occluder_size: [0.1, 0.3]       # of boxes and cylinders, by the part's diameter
    sensor: global-shutter          # or a sensor file
    samples: 2                      # n x n rays a pixel
    gray: false
    key_points: points.csv          # name, X, Y, Z (mm)

File names are relative to the working directory of the command.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from cadcam.cad.read import read_model
from cadcam.camera.camera import Camera
from cadcam.dataset.key_points import read_key_points
from cadcam.dataset.plan import BOX, CYLINDER, NOISE, PLAIN, DatasetPlan, Lights, Occluders, Span
from cadcam.errors import BadValue, UnknownName, UnreadableFile
from cadcam.files.camera import read_camera
from cadcam.files.jsontext import Place
from cadcam.files.poses import read_poses
from cadcam.files.sensor import named_sensor
from cadcam.files.text import read_text
from cadcam.files.yamltext import parsed_yaml
from cadcam.image.suffixes import READABLE
from cadcam.locate.views.view_range import ViewRange

KEYS = (
    *("count", "seed", "camera", "size", "view_angle_deg", "focal_jitter_percent", "center_jitter_px"),
    *("seen_from", "up", "roll_deg", "fill", "distance_mm", "off_center", "poses", "head", "distant", "ambient"),
    *("backgrounds", "occluders", "occluder_shapes", "occluder_size", "sensor", "samples", "gray", "key_points"),
)
_DRAWN = ("seen_from", "up", "roll_deg", "fill", "distance_mm", "off_center")
_COUNT, _SIZE, _ANGLE_DEG = 100, (640, 480), 40.0


def option_of(key: str) -> str:
    """Return the option of a key, such as --roll of roll_deg: an option's unit stands in its help."""
    return "--" + re.sub("_(mm|deg|px|percent)$", "", key).replace("_", "-")


def read_plan(path: str | os.PathLike[str] | None, options: Mapping[str, Any] | None = None) -> DatasetPlan:
    """Return the plan in a file, with `options` over its keys. Raises `UnreadableFile` naming the key that is wrong."""
    place = Place("options", (), {}) if path is None else parsed_yaml(read_text(path))
    place.only(*KEYS)
    given = _Given(place, dict(options or {}))
    return given.plan()


class _Given:
    """Values by key: those of the options before those of the file."""

    def __init__(self, file: Place, options: dict[str, Any]) -> None:
        self._file, self._options = file, options

    def place(self, key: str) -> Place | None:
        if key in self._options:
            return Place(option_of(key), (), self._options[key])
        return self._file.at(key) if key in self._file.object else None

    def name(self, key: str) -> str:
        """Return what the user called it: the option, or the key of the file."""
        return option_of(key) if key in self._options else key

    def has(self, key: str) -> bool:
        return self.place(key) is not None

    def number(self, key: str, default: float) -> float:
        place = self.place(key)
        return default if place is None else place.number()

    def whole(self, key: str, default: int) -> int:
        place = self.place(key)
        return default if place is None else place.whole()

    def text(self, key: str) -> str | None:
        place = self.place(key)
        return None if place is None else place.text()

    def span(self, key: str, default: Span) -> Span:
        place = self.place(key)
        if place is None:
            return default
        values = [place.number()] * 2 if not isinstance(place.value, list) else place.array((2,)).tolist()
        return float(values[0]), float(values[1])

    def words(self, key: str, default: tuple[str, ...]) -> tuple[str, ...]:
        place = self.place(key)
        if place is None:
            return default
        return (place.text(),) if isinstance(place.value, str) else place.texts()

    def plan(self) -> DatasetPlan:
        """Return the plan; what is refused is reported with its key."""
        if self.has("poses") and (beside := [key for key in _DRAWN if self.has(key)]):
            with_poses = f"given beside {self.name('poses')}"
            raise BadValue(self.name(beside[0]), with_poses, "one of them: poses say where the camera stands")
        if self.has("fill") and self.has("distance_mm"):
            with_distance = f"given beside {self.name('distance_mm')}"
            raise BadValue(self.name("fill"), with_distance, "one of them: either says how far the camera stands")
        poses, sensor, points = self.text("poses"), self.text("sensor"), self.text("key_points")
        listed = tuple(read_poses(poses).values()) if poses else ()
        names, places = read_key_points(points) if points else ((), None)
        return DatasetPlan(
            views=self.whole("count", len(listed) or _COUNT),
            seed=self.whole("seed", 0),
            camera=self._camera(),
            focal_jitter=self.number("focal_jitter_percent", 0.0) / 100,
            center_jitter_px=self.number("center_jitter_px", 0.0),
            poses=listed,
            around=self._around(),
            fill=self.span("fill", (0.4, 0.9)),
            off_center=self.number("off_center", 0.1),
            lights=Lights(**{key: self.span(key, getattr(Lights(), key)) for key in ("head", "distant", "ambient")}),
            backgrounds=self._backgrounds(),
            occluders=self._occluders(),
            sensor=None if sensor is None else named_sensor(sensor),
            samples=self.whole("samples", 2),
            gray=self._flag("gray"),
            key_points=places,
            key_point_names=names,
        )

    def _flag(self, key: str) -> bool:
        place = self.place(key)
        return place is not None and place.flag()

    def _camera(self) -> Camera:
        file = self.text("camera")
        if file is not None:
            if beside := [key for key in ("size", "view_angle_deg") if self.has(key)]:
                raise BadValue(self.name(beside[0]), "given beside a camera", "one of them: the camera file says it")
            return read_camera(file).camera
        place = self.place("size")
        width, height = _SIZE if place is None else place.array((2,)).tolist()
        angle = self.number("view_angle_deg", _ANGLE_DEG)
        if not 1 <= angle <= 150:
            raise BadValue(self.name("view_angle_deg"), angle, "1 to 150 degrees over the picture's shorter side")
        return Camera.from_focal((width, height), min(width, height) / 2 / math.tan(math.radians(angle) / 2))

    def _around(self) -> ViewRange:
        axis, half_angle = self._sides()
        up = self.place("up")
        return ViewRange(
            axis=axis,
            half_angle_deg=half_angle,
            up=np.array([0.0, 0.0, 1.0]) if up is None else up.array((3,)),
            roll_deg=self.number("roll_deg", 180.0),
            distance_mm=self.span("distance_mm", (0.0, 0.0)) if self.has("distance_mm") else None,
        )

    def _sides(self) -> tuple[Any, float]:
        """Return axis and half angle (degrees) of any, above, above:DEG or X,Y,Z:DEG."""
        text = self.text("seen_from") or "any"
        where, _, angle = text.partition(":")
        axes = {"any": [0.0, 0.0, 1.0], "above": [0.0, 0.0, 1.0]}
        try:
            axis = axes[where] if where in axes else [float(v) for v in where.split(",")]
            degrees = float(angle) if angle else (180.0 if where == "any" else 80.0)
        except ValueError:
            axis = []
        if len(axis) != 3:
            raise BadValue(self.name("seen_from"), repr(text), "any, above, above:DEG or X,Y,Z:DEG")
        return np.array(axis), degrees

    def _backgrounds(self) -> tuple[str | Path, ...]:
        found: list[str | Path] = []
        for word in self.words("backgrounds", (PLAIN,)):
            found += [word] if word in (PLAIN, NOISE) else _photos(word)
        return tuple(found)

    def _occluders(self) -> Occluders:
        low, high = self.span("occluders", (0.0, 0.0))
        if low != int(low) or high != int(high):
            raise BadValue(self.name("occluders"), (low, high), "whole numbers: (fewest, most)")
        words = self.words("occluder_shapes", (BOX, CYLINDER))
        files = [word for word in words if word not in (BOX, CYLINDER)]
        for word in files:
            if not Path(word).suffix:
                raise UnknownName("occluder shape", word, (BOX, CYLINDER, "a CAD file"))
        return Occluders(
            (int(low), int(high)),
            tuple(word for word in words if word in (BOX, CYLINDER)),
            self.span("occluder_size", (0.1, 0.3)),
            tuple(map(partial(read_model, unit=None), files)),
        )


def _photos(word: str) -> list[str | Path]:
    """Return the photo of this name, or those in the folder of this name, in the order of their names."""
    path = Path(word)
    if not path.exists():
        if path.suffix or "/" in word:
            raise UnreadableFile(word, "no such file or folder", f"name photos, a folder of them, {PLAIN} or {NOISE}")
        raise UnknownName("background", word, (PLAIN, NOISE, "a folder of photos"))
    files = sorted(f for f in path.iterdir() if f.suffix.lower() in READABLE) if path.is_dir() else [path]
    if not files:
        raise UnreadableFile(word, "holds no photo", f"put some there ({', '.join(READABLE)})")
    return list(files)
