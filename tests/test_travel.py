"""What is made and found travels to other processes, and is the same there: a service hands it to its workers."""

from __future__ import annotations

import copy
import pickle
import re
from dataclasses import fields, is_dataclass, replace
from typing import Any

import numpy as np
import pytest

import cadcam
from cadcam.arrays import Locked
from cadcam.cad.parts.shape import box
from cadcam.kinds import FrozenMap

CAMERA = cadcam.Camera.from_focal((80, 60), 90.0, lens=cadcam.BrownConrady(-0.1))
POSE = cadcam.Rigid.look_at((700, -500, 600), (150, 100, 50))


@pytest.fixture(scope="module")
def scene() -> cadcam.Scene:
    return cadcam.Scene.of(box((0, 0, 0), (300, 200, 100), name="box"))


def there(value: Any) -> Any:
    return pickle.loads(pickle.dumps(value))


@pytest.mark.parametrize("renderer", ["raster", "ray", "auto"])
def test_a_renderer_draws_the_same_elsewhere(scene: cadcam.Scene, renderer: str) -> None:
    here = cadcam.open_renderer(scene, renderer, threads=2)
    view, again = (one.render(CAMERA, POSE) for one in (here, there(here)))
    assert repr(there(here)) == repr(here)
    assert view.depth.tobytes() == again.depth.tobytes() == there(view).depth.tobytes()
    assert view.image.tobytes() == copy.deepcopy(view).image.tobytes()


def test_a_photographer_takes_the_same_picture_elsewhere(scene: cadcam.Scene) -> None:
    here = cadcam.Photographer(scene, threads=1)
    light = cadcam.named_light("hall")
    taken = here.radiance(CAMERA, POSE, light=light, samples=2)  # now it holds what cannot travel
    again = there(here).radiance(CAMERA, POSE, light=light, samples=2)
    assert taken.color.tobytes() == again.color.tobytes()


def test_a_verification_travels_with_its_tolerances(scene: cadcam.Scene) -> None:
    nowhere = cadcam.Location.nowhere(POSE, "nothing was looked at")
    photo = cadcam.Photo.of(np.linspace(0.2, 0.8, 4800).reshape(60, 80), CAMERA, POSE)
    tolerances = replace(cadcam.whole_parts(scene), notes={"bracket": "of the drawing"})
    found = cadcam.verify_part(cadcam.Part(scene), [photo], nowhere, tolerances)
    again = there(found)
    assert repr(again) == repr(found)
    assert again.tolerances.notes == {"bracket": "of the drawing"}


def test_a_measurement_and_a_prediction_travel() -> None:
    seen = [
        cadcam.Viewpoint.exact(name, CAMERA, cadcam.Rigid.look_at(eye, (0, 0, 0)), sigma_px=0.1)
        for name, eye in (("left", (-300, 0, 900)), ("right", (300, 0, 900)))
    ]
    q = np.stack([v.camera.project(v.camera_from_world @ np.zeros((1, 3))) for v in seen])
    measured = cadcam.measure_points(seen, q)
    assert there(measured).refused == measured.refused
    predicted = cadcam.predict_points(seen, np.zeros((1, 3)))
    assert set(there(predicted).by_cause) == set(predicted.by_cause)


def test_a_style_is_a_value() -> None:
    """Equal ones have one hash, whatever mapping the colours came in, and do not follow that mapping afterwards."""
    kinds = dict(cadcam.LineStyle().kinds)
    style = cadcam.LineStyle(kinds=kinds)
    assert style == there(style) == cadcam.LineStyle()
    assert hash(style) == hash(cadcam.LineStyle())
    kinds.clear()
    assert style == cadcam.LineStyle()


def test_a_frozen_map_is_read_only() -> None:
    map_ = FrozenMap({"a": 1})
    assert map_ == {"a": 1}
    with pytest.raises(TypeError):
        map_["b"] = 2  # type: ignore[index]


def _arrays(value: Any) -> dict[str, np.ndarray]:
    return {f.name: a for f in fields(value) if isinstance(a := getattr(value, f.name), np.ndarray)}


def test_arrays_that_are_read_only_are_so_elsewhere(scene: cadcam.Scene) -> None:
    """Numpy drops the flag in pickles and deep copies: the colours of a scene could be painted over by accident."""
    observations = cadcam.Observations(np.eye(3), np.eye(3)[:, :2])
    values = [CAMERA, POSE, scene, scene.mesh, observations, cadcam.PoseEstimate(POSE, np.eye(6)), cadcam.Freedom()]
    values += [cadcam.Photo.of(np.full((60, 80), 0.5), CAMERA), cadcam.ViewRange(), cadcam.parse_mark("ring:20mm:30mm")]
    for value in values:
        for again in (there(value), copy.deepcopy(value), copy.copy(value)):
            assert {n: a.flags.writeable for n, a in _arrays(again).items()} == {
                n: a.flags.writeable for n, a in _arrays(value).items()
            }
            assert all(np.array_equal(a, _arrays(again)[n], equal_nan=True) for n, a in _arrays(value).items())
        assert not all(a.flags.writeable for a in _arrays(value).values())


def test_every_public_value_with_arrays_keeps_them_read_only() -> None:
    for name in cadcam.__all__:
        kind = getattr(cadcam, name)
        arrays = is_dataclass(kind) and any(re.match(r"Array|Picture|Ids|Mask", str(f.type)) for f in fields(kind))
        assert not arrays or issubclass(kind, Locked), f"{name}: derive it from Locked, or from Brief"
