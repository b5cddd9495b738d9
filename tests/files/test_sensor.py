"""A sensor file is read back as written, and errors in it are named."""

from __future__ import annotations

import json

import pytest

from cadcam.errors import UnknownName, UnreadableFile
from cadcam.files.sensor import named_sensor, read_sensor, write_sensor
from cadcam.image.sensor.light import Blur, Motion
from cadcam.image.sensor.presets import PRESETS
from cadcam.image.sensor.sensor import EFFECTS, Sensor

HEAD = {"format": "cadcam sensor", "version": 1}


def written(tmp_path, document):
    path = tmp_path / "hall.json"
    path.write_text(json.dumps(document))
    return path


@pytest.mark.parametrize(
    "sensor", [*PRESETS.values(), Sensor(name="all", **{n: kind() for n, kind in EFFECTS.items()})]
)
def test_a_sensor_comes_back_as_it_was(tmp_path, sensor):
    write_sensor(tmp_path / "sensor.json", sensor)
    assert read_sensor(tmp_path / "sensor.json") == sensor


def test_what_is_left_out_does_not_happen_and_has_its_default(tmp_path):
    sensor = read_sensor(written(tmp_path, {**HEAD, "blur": {"sigma_px": 1}, "motion": {"shift_px": [2, 0.5]}}))
    assert sensor == Sensor(name="hall", blur=Blur(1.0), motion=Motion((2.0, 0.5)))


@pytest.mark.parametrize(
    ("document", "message"),
    [
        ({**HEAD, "blurr": {}}, "did you mean 'blur'"),
        ({**HEAD, "blur": {"sigma": 1}}, "did you mean 'sigma_px'"),
        ({**HEAD, "gamma": {"gamma": 0}}, "gamma is refused: gamma is 0.0"),
        ({**HEAD, "gamma": {"gamma": "0.6"}}, 'gamma.gamma is "0.6"'),
        ({**HEAD, "noise": 3}, "noise is 3"),
        ({**HEAD, "motion": {"shift_px": [1]}}, "motion.shift_px has shape"),
        ({**HEAD, "quantization": {"bits": 7.5}}, "a whole number from 1 to 16"),
        ({**HEAD, "edge_enhancement": {"vertical": 1}}, "true or false"),
        ({"version": 1}, "begins with"),
        ({"format": "cadcam sensor", "version": 9}, "version 9"),
    ],
)
def test_what_is_wrong_is_named_with_its_place(tmp_path, document, message):
    with pytest.raises(UnreadableFile) as refused:
        read_sensor(written(tmp_path, document))
    assert message in str(refused.value)
    assert "hall.json" in str(refused.value)


def test_a_name_is_a_preset_or_a_file(tmp_path):
    assert named_sensor("phone") == PRESETS["phone"]
    path = written(tmp_path, HEAD)
    assert named_sensor(str(path)) == Sensor(name="hall")
    with pytest.raises(UnknownName, match="did you mean 'ccir-1996'"):
        named_sensor("ccir1996")
    with pytest.raises(UnreadableFile, match="or one of ccir-1996"):
        named_sensor(str(tmp_path / "none.json"))
