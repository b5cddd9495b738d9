"""Plans from files and options: what stands where is taken, what is wrong is named with what would be right."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cadcam.cad.parts.shape import box
from cadcam.cad.write import write_model
from cadcam.dataset.make import make_dataset
from cadcam.dataset.plan import Occluders
from cadcam.dataset.plan_file import read_plan
from cadcam.errors import CadcamError, UnknownName, UnreadableFile
from cadcam.files.camera import write_camera
from cadcam.files.poses import write_poses
from cadcam.geometry.plane import Plane
from cadcam.geometry.rigid import Rigid
from cadcam.image.picture import write_picture
from cadcam.image.sensor.light import PixelAspect
from cadcam.image.sensor.sensor import Sensor
from cadcam.locate.views.resting import OnPlane
from cadcam.locate.views.view_range import ViewRange

from .sets import CAMERA, plan, scene

FULL = """
count: 12
seed: 3
size: [320, 240]
view_angle_deg: 60
seen_from: 1,0,0:30
up: [0, 1, 0]
roll_deg: 15
distance_mm: [500, 700]
off_center: 0
head: 0.4
backgrounds: [noise, photos]
occluders: [1, 2]
occluder_shapes: [cylinder, clamp.stl]
sensor: phone
gray: true
key_points: points.csv
"""


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    for name in ("b.png", "a.jpg"):
        write_picture(tmp_path / "photos" / name, np.full((4, 6), 0.5))
    write_model(tmp_path / "clamp.stl", box((0, 0, 0), (5, 5, 5), name="clamp"))
    (tmp_path / "points.csv").write_text("name, X, Y, Z\nnose, 1, 2, 3\ntail, -1, 0, 0\n")
    (tmp_path / "plan.yaml").write_text(FULL)
    write_camera(tmp_path / "camera.json", CAMERA)
    write_poses(tmp_path / "poses.csv", {"a": Rigid(np.eye(3), np.array([0.0, 0, 300])), "b": Rigid()})
    return tmp_path


def test_a_file_says_everything_and_options_go_before_it(here: Path) -> None:
    plan = read_plan("plan.yaml", {"count": 7, "occluders": [0.0, 4.0]})
    assert (plan.views, plan.seed, plan.camera.size, plan.gray) == (7, 3, (320, 240), True)
    assert plan.camera.fy == pytest.approx(120 / np.tan(np.radians(30)))
    assert (plan.around.half_angle_deg, plan.around.roll_deg, plan.around.distance_mm) == (30, 15, (500, 700))
    assert plan.around.axis.tolist() == [1, 0, 0]
    assert plan.lights.head == (0.4, 0.4)
    assert [getattr(b, "name", b) for b in plan.backgrounds] == ["noise", "a.jpg", "b.png"]
    assert (plan.occluders.count, plan.occluders.shapes) == ((0, 4), ("cylinder",))
    assert [mesh.part_names for mesh in plan.occluders.meshes] == [("clamp",)]
    assert plan.sensor is not None and plan.sensor.name == "phone"  # noqa: PT018
    assert plan.key_point_names == ("nose", "tail")


def test_poses_and_a_camera_say_how_many_views_there_are(here: Path) -> None:
    plan = read_plan(None, {"camera": "camera.json", "poses": "poses.csv"})
    assert plan.views == len(plan.poses) == 2
    assert plan.camera.K.tolist() == CAMERA.K.tolist()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"count": 0}, "views is 0; expected a whole number from 1"),
        ({"seed": -1}, "seed is -1"),
        ({"size": [0, 240]}, "picture size is .0.0, 240.0."),
        ({"size": [320.5, 240]}, "picture size is .320.5, 240"),
        ({"occluders": [0.5, 2]}, "occluders is .0.5, 2.0.; expected whole numbers"),
        ({"view_angle_deg": 0}, "--view-angle is 0.0; expected 1 to 150 degrees"),
        ({"camera": "camera.json", "size": [10, 10]}, "--size is given beside a camera"),
        ({"camera": "none.json"}, "none.json: no such file"),
        ({"poses": "poses.csv", "fill": [1, 2]}, "--fill is given beside --poses"),
        ({"seen_from": "abov"}, "--seen-from is 'abov'; expected any, above, above:DEG or X,Y,Z:DEG"),
        ({"seen_from": "0,0,0:10"}, "axis of the views is .0.0, 0.0, 0.0.; expected a direction"),
        ({"roll_deg": 400}, "roll_deg of the views is 400"),
        ({"fill": [3, 4]}, "fill is .3.0, 4.0.; expected the part's diameter by .* to 2; closer by distance_mm"),
        ({"fill": [0.9, 0.4]}, "fill is .0.9, 0.4.; expected .least, greatest."),
        ({"distance_mm": [-1, 4]}, "distance_mm"),
        ({"head": [0, -1]}, "strength of the head light"),
        ({"backgrounds": ["nois"]}, "unknown background 'nois'; did you mean 'noise'"),
        ({"backgrounds": ["pics/"]}, "pics/: no such file or folder"),
        ({"occluders": [3, 1]}, "occluders is .3, 1."),
        ({"occluders": [0, 1], "occluder_shapes": ["bax"]}, "unknown occluder shape 'bax'; did you mean 'box'"),
        ({"occluder_shapes": ["lost.stl"]}, "lost.stl: does not exist"),
        ({"occluder_size": [0, 1]}, "occluder_size is .0.0, 1.0."),
        ({"sensor": "phon"}, "unknown sensor 'phon'; did you mean 'phone'"),
        ({"samples": 9}, "samples is 9"),
        ({"focal_jitter_percent": 50}, "focal_jitter_percent is 50"),
        ({"off_center": 2}, "off_center is 2"),
        ({"key_points": "camera.json"}, "camera.json: "),
    ],
    ids=lambda value: "-".join(value) if isinstance(value, dict) else "",
)
def test_what_is_wrong_is_named(here: Path, options: dict[str, Any], message: str) -> None:
    with pytest.raises(CadcamError, match=message):
        read_plan(None, options)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("counts: 3", "has an unknown key 'counts'; did you mean 'count'"),
        ("count: many", 'count is "many"'),
        ("count: 2.5", "count is 2.5; a whole number is expected"),
        ("gray: 3", "gray is 3"),
        ("fill: [1, 2, 3]", "fill has shape .3,."),
        ("- 1", "is \\[1.0\\]; .key: value. lines are expected"),
        ("", "is empty"),
    ],
)
def test_what_is_wrong_in_a_file_is_named_with_its_key(here: Path, text: str, message: str) -> None:
    (here / "bad.yaml").write_text(text)
    with pytest.raises(CadcamError, match=f"bad.yaml.*({message})"):
        read_plan("bad.yaml")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("name, X, Y\na, 1, 2\n", "has no column 'z'"),
        ("name, X, Y, Z, W\n", "names an unknown column 'w'"),
        ("name, X, Y, Z\na, 1, 2, up\n", "line 2, Z is 'up', not a number"),
        ("name, X, Y, Z\na, 1, 2, 3\na, 1, 2, 3\n", "line 3 names 'a' again"),
        ("name, X, Y, Z\n", "holds 0 points"),
        ("name, X, Y, Z\na, 1\n", "line 2 has 2 cells; there are 4"),
    ],
)
def test_key_points_that_cannot_be_read_are_named_by_line(here: Path, text: str, message: str) -> None:
    (here / "bad.csv").write_text(text)
    with pytest.raises(CadcamError, match=f"bad.csv: .*{message}"):
        read_plan(None, {"key_points": "bad.csv"})


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"sensor": Sensor(pixel_aspect=PixelAspect(2.0))}, "pixel_aspect of the sensor is given; expected none"),
        ({"gray": "no"}, "gray is"),
        ({"around": ViewRange(on=OnPlane(Plane(np.array([0.0, 0, 1]), np.array(0.0))))}, "on of the views"),
        ({"key_points": np.zeros((1, 2)), "key_point_names": ("a",)}, "key_points"),
        ({"key_points": np.full((1, 3), np.nan), "key_point_names": ("a",)}, "key_points"),
        ({"key_points": np.zeros((1, 3)), "key_point_names": ("a", "b")}, "is 2 names; expected one for each of 1 p"),
        ({"key_points": np.zeros((1, 3))}, "key_point_names is 0 names; expected one for each of 1 points"),
        ({"backgrounds": ("photo.png",)}, "background is 'photo.png'; expected plain, noise, or a photo as a path"),
    ],
)
def test_what_no_picture_or_label_could_be_made_of_is_refused(wrong: dict[str, Any], message: str) -> None:
    with pytest.raises(CadcamError, match=message):
        plan(**wrong)


def test_a_shape_of_occluders_that_is_none_is_refused() -> None:
    with pytest.raises(UnknownName, match="unknown occluder shape 'bax'; did you mean 'box'"):
        Occluders((0, 1), shapes=("bax",))


def test_a_photo_that_is_not_there_is_one_error(tmp_path: Path) -> None:
    with pytest.raises(UnreadableFile, match=r"lost\.png: No such file"):
        make_dataset(tmp_path / "set", scene(), plan(1, backgrounds=(tmp_path / "lost.png",)), workers=1)
