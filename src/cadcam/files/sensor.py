"""The sensor file: JSON, an object for each effect with its numbers; effects left out do not occur.

    {"format": "cadcam sensor", "version": 1, "name": "hall camera",
     "blur": {"sigma_px": 0.8},
     "noise": {"full_well_e": 20000, "read_e": 12},
     "gamma": {"gamma": 0.6},
     "quantization": {"bits": 8}}

The effects and their numbers are those of `image.sensor`, in any order: they act in the order of `Sensor`.
"""

from __future__ import annotations

import os
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

from cadcam.errors import UnreadableFile
from cadcam.files.jsontext import Place, as_json, parsed
from cadcam.files.text import read_text
from cadcam.image.sensor.presets import PRESETS, preset
from cadcam.image.sensor.sensor import EFFECTS, Sensor
from cadcam.kinds import expect, expect_path
from cadcam.whole import write_whole

FORMAT, VERSION = "cadcam sensor", 1


def read_sensor(path: str | os.PathLike[str]) -> Sensor:
    """Return the sensor in a file. Raises `UnreadableFile` naming the key that is wrong and the nearest known one."""
    place = parsed(read_text(path))
    place.check_head(FORMAT, VERSION, remedy=f'a sensor file begins with "format": {FORMAT!r}')
    place.only("format", "version", "name", *EFFECTS)
    name = place.at("name").text() if "name" in place.object else Path(path).stem
    effects = {key: _effect(place.at(key), key) for key in EFFECTS if key in place.object}
    return Sensor(name=name, **effects)


def named_sensor(name: str) -> Sensor:
    """Return the preset of this name, or else the sensor in the file of this name."""
    expect_path(name, "sensor")
    name = os.fspath(name)
    if name in PRESETS:
        return PRESETS[name]
    if not Path(name).exists() and not Path(name).suffix:
        return preset(name)
    try:
        return read_sensor(name)
    except UnreadableFile as error:
        if Path(name).exists():
            raise
        known = ", ".join(PRESETS)
        raise UnreadableFile(name, "no such file", f"name a sensor file or one of {known}") from error


def write_sensor(path: str | os.PathLike[str], sensor: Sensor) -> None:
    """Write a sensor, whole or not at all; floats keep every bit."""
    expect_path(path)
    expect(sensor, "sensor", Sensor)
    write_whole(path, as_json(sensor_as_json(sensor)))


def sensor_as_json(sensor: Sensor) -> dict[str, Any]:
    """Return the JSON document that `write_sensor` writes: all numbers of every effect present."""
    numbers = asdict(sensor)
    effects = {name: _plain(numbers[name]) for name in sensor.effects}
    return {"format": FORMAT, "version": VERSION, "name": sensor.name, **effects}


def _plain(numbers: dict[str, Any]) -> dict[str, Any]:
    return {key: list(value) if isinstance(value, tuple) else value for key, value in numbers.items()}


def _effect(place: Place, name: str) -> Any:
    kind: Any = EFFECTS[name]
    defaults = {f.name: f.default for f in fields(kind)}
    place.only(*defaults)
    given = {key: _value(place.at(key), defaults[key]) for key in place.object}
    return place.build(lambda: kind(**given))


def _value(place: Place, like: object) -> object:
    """Return the value at a place, read as the type of the default value."""
    if isinstance(like, bool):
        if not isinstance(place.value, bool):
            raise place.error(f"is {place.value!r}", "true or false is expected")
        return place.value
    if isinstance(like, tuple):
        return tuple(place.array((len(like),)).tolist())
    number = place.number()
    return int(number) if isinstance(like, int) and number == int(number) else number
