"""A camera file is read back as written, to the last bit, and unknown contents are refused."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cadcam.camera.camera import Camera
from cadcam.camera.estimate import CameraEstimate
from cadcam.camera.extended_pinhole import NAMES, ExtendedPinhole
from cadcam.camera.lens import LENSES, BrownConrady, Lens
from cadcam.camera.observations import Observations
from cadcam.errors import BadValue, UnreadableFile, UnwritableFile
from cadcam.files.camera import camera_as_json, read_camera, write_camera
from cadcam.geometry.rigid import Rigid

POSE = Rigid.look_at([1000 / 3, 200, -900], [0.1, 0.2, 0.3])
MINIMAL = {"size_px": [640, 480], "fx_px": 500, "fy_px": 501, "cx_px": 320, "cy_px": 240}


def estimate(rng: np.random.Generator, lens: Lens) -> CameraEstimate:
    """A made-up estimate with residuals: what a file must carry does not depend on how it was found."""
    camera = Camera.from_focal((768, 576), 2400 / 3, fy=801, skew=0.1, cx=350.3, lens=lens)
    p = rng.uniform(-50, 50, (9, 3))
    q = camera.project(POSE @ p) + rng.normal(scale=0.3, size=(9, 2))
    n = len(NAMES) + len(lens.parameters)
    A = rng.normal(size=(n, n))
    return CameraEstimate(camera, POSE, Observations(p, q), (*NAMES[:6], "focal"), A @ A.T, "made up")


def written(folder: Path, document: Any) -> Path:
    path = folder / "camera.json"
    path.write_text(document if isinstance(document, str) else json.dumps(document))
    return path


@pytest.mark.parametrize("model", sorted(LENSES))
def test_an_estimate_round_trips_to_the_last_bit(tmp_path: Path, rng: np.random.Generator, model: str) -> None:
    lens = LENSES[model]()
    given = estimate(rng, type(lens)(*(0.01 / (3 + i) for i in range(len(lens.parameters)))))
    write_camera(tmp_path / "camera.json", given)
    back = read_camera(tmp_path / "camera.json")
    assert back.camera.size == given.camera.size
    assert back.camera.lens == given.camera.lens
    np.testing.assert_array_equal(back.camera.K, given.camera.K)
    assert back.camera_from_world is not None
    np.testing.assert_array_equal(back.camera_from_world.matrix, given.camera_from_world.matrix)
    assert back.estimate is not None
    assert back.estimate.free == given.free
    assert back.estimate.method == given.method
    assert back.estimate.observations.names == given.observations.names
    assert back.estimate.observations.sha256 == given.observations.sha256
    np.testing.assert_array_equal(back.estimate.covariance, given.covariance)
    np.testing.assert_array_equal(back.estimate.residuals, given.residuals)


def test_writing_what_was_read_gives_the_same_file(tmp_path: Path, rng: np.random.Generator) -> None:
    one, two = tmp_path / "one.json", tmp_path / "two.json"
    given = estimate(rng, BrownConrady(k1=-0.1))
    other = replace(given, camera_from_world=given.camera_from_world @ Rigid.exp(np.full(6, 0.01)))
    write_camera(one, replace(given, alternative=other))
    again = read_camera(one).estimate
    assert again is not None
    assert again.alternative is not None
    write_camera(two, again)
    assert one.read_bytes() == two.read_bytes()


def test_a_camera_alone_and_with_its_pose(tmp_path: Path) -> None:
    camera = Camera.from_focal((100, 50), 1 / 3 * 1000)
    write_camera(tmp_path / "a.json", camera)
    assert read_camera(tmp_path / "a.json").camera_from_world is None
    write_camera(tmp_path / "b.json", camera, camera_from_world=POSE)
    pose = read_camera(tmp_path / "b.json").camera_from_world
    assert pose is not None
    np.testing.assert_array_equal(pose.matrix, POSE.matrix)


def test_a_file_says_what_its_numbers_mean_and_is_read_without(tmp_path: Path) -> None:
    """A point goes into the picture by the stated rules, with nothing but the file."""
    camera = Camera.from_focal((768, 576), 800.0, fy=801, skew=0.1, cx=350.3)
    write_camera(tmp_path / "camera.json", camera, camera_from_world=POSE)
    said = json.loads((tmp_path / "camera.json").read_text())
    for rule in ("p_camera = rotation @ p_world + translation_mm", "(0, 0) the centre of the top-left", "z forward"):
        assert rule in said["convention"]
    p = np.array([3.0, -4.0, 50.0])
    at = np.array(said["camera_from_world"]["rotation"]) @ p + said["camera_from_world"]["translation_mm"]
    x, y, w = np.array(said["K_px"]) @ at
    np.testing.assert_allclose([x / w, y / w], camera.project(POSE @ p), atol=1e-9)
    del said["convention"]
    without = read_camera(written(tmp_path, said))
    assert (without.camera.K == camera.K).all()


def test_an_estimate_has_its_own_pose(tmp_path: Path, rng: np.random.Generator) -> None:
    with pytest.raises(BadValue, match="has its own"):
        write_camera(tmp_path / "a.json", estimate(rng, BrownConrady()), camera_from_world=POSE)


def test_a_file_written_by_hand_needs_a_size_and_the_camera_matrix(tmp_path: Path) -> None:
    for document in (MINIMAL, {"size_px": [640, 480], "K_px": [[500, 0, 320], [0, 501, 240], [0, 0, 1]]}):
        camera = read_camera(written(tmp_path, document)).camera
        np.testing.assert_array_equal(camera.K, [[500, 0, 320], [0, 501, 240], [0, 0, 1]])
        assert camera.size == (640, 480)


def test_the_parameters_stand_in_the_file_for_people(rng: np.random.Generator) -> None:
    given = estimate(rng, BrownConrady())
    parameters = camera_as_json(given)["estimate"]["parameters"]
    model = ExtendedPinhole.from_camera(given.camera, POSE)
    assert parameters["focal_px"]["value"] == model.focal
    assert parameters["focal_px"]["sigma"] == given.sigma("focal")
    assert parameters["X_mm"]["free"] is True
    assert parameters["aspect"] == {"value": model.aspect, "sigma": 0.0, "free": False}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"lenz": 1}, "unknown key 'lenz'; did you mean 'lens'"),
        ({"version": 2}, "has version 2; this cadcam .* reads version 1"),
        ({"format": "other"}, "says its format is 'other'"),
        ({"lens": {"model": "brown-conradi"}}, "lens names an unknown lens model 'brown-conradi'; did you mean"),
        ({"lens": {"model": "division", "k1": 0.1}}, "lens has an unknown key 'k1'"),
        ({"lens": {"model": "division", "k": "x"}}, r'lens\.k is "x"; a number is expected'),
        ({"lens": {"k1": 0.1}}, "lens has no 'model'"),
        ({"fx_px": -1}, "two positive numbers"),
        ({"fx_px": None}, "fx_px is null"),
        ({"fx_px": True}, "fx_px is true"),
        ({"K_px": [[1]]}, "has K_px and fx_px"),
        ({"size_px": [640.5, 480]}, "two whole numbers"),
        ({"size_px": "640x480"}, 'size_px is "640x480"'),
        (
            {"camera_from_world": {"rotation": [[2, 0, 0], [0, 1, 0], [0, 0, 1]], "translation_mm": [0, 0, 1]}},
            "orthonormal",
        ),
        ({"camera_from_world": {"rotation": [[1, 0, 0], [0, 1, 0], [0, 0, 1]]}}, "needs one translation with its unit"),
        ({"estimate": {}}, "has an estimate but no camera_from_world"),
    ],
)
def test_what_is_not_understood_is_refused_with_its_key(tmp_path: Path, change: dict[str, Any], message: str) -> None:
    path = written(tmp_path, MINIMAL | change)
    with pytest.raises(UnreadableFile, match=message) as caught:
        read_camera(path)
    assert str(caught.value).startswith(str(path))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('{"size_px": [640, 480],', "is not JSON.*line 1.*cut off"),
        ("[1, 2]", "an object"),
        (
            '{"size_px": [640, 480], "fx_px": NaN, "fy_px": 1, "cx_px": 1, "cy_px": 1}',
            "fx_px is not finite; a number is expected",
        ),
        ('{"size_px": [640, 480], "size_px": [1, 1]}', "has the key 'size_px' twice"),
        ('{"fx_px": 1}', "has no 'size_px'"),
        ("[image]\n\nwidth\n640\n", r"is not JSON, as .*; cadcam\.read_cameras"),
        ("", "is not JSON.*cut off|is empty"),
        ('{"size_px": [640, 480]}', "has no camera matrix"),
        (
            '{"width": 640, "fx": 500}',
            r"is JSON, but no camera file \(it has width, fx\).*read_cameras.*the least read here is",
        ),
        (
            "%YAML:1.0\n---\nimage_width: 640\n",
            r"is not JSON, as .*; cadcam\.read_cameras reads those of OpenCV, Kalibr",
        ),
    ],
)
def test_broken_json_is_refused_with_its_place(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(UnreadableFile, match=message):
        read_camera(written(tmp_path, text))


def test_a_camera_edited_by_hand_cannot_keep_its_covariance(tmp_path: Path, rng: np.random.Generator) -> None:
    document = camera_as_json(estimate(rng, BrownConrady()))
    document["K_px"][0][0] += 0.1
    with pytest.raises(UnreadableFile, match=r"states a residual of .* the file was edited"):
        read_camera(written(tmp_path, document))


def test_a_refused_write_leaves_the_old_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = written(tmp_path, MINIMAL)
    before = path.read_bytes()

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.replace", full)
    with pytest.raises(UnwritableFile, match="No space left"):
        write_camera(path, Camera.from_focal((10, 10), 5))
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]
