"""Files that other programs wrote, from public data sets, are read as those programs mean them."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from cadcam.camera.lens import BrownConrady, Ideal
from cadcam.errors import UnreadableFile
from cadcam.files.foreign.registry import read_cameras

Shared = Callable[[str], Path]


def test_opencvs_own_sample_with_its_thirteen_views(shared: Shared) -> None:
    path = shared("data/opencv_stereo_chess/left_intrinsics.yml")
    found = read_cameras(path, unit="m")
    assert found.format == "opencv"
    assert len(found.cameras) == 13
    camera = found.cameras[0].camera
    assert camera.size == (640, 480)
    assert camera.fx == camera.fy == 535.91573396163199
    assert camera.principal_point.tolist() == [342.28315473308373, 235.57082909788173]
    assert isinstance(camera.lens, BrownConrady)
    assert camera.lens.k3 == 0.23839153080878486
    assert camera.lens.p1 == 0.0017831947042852964
    assert all(named.camera is camera for named in found.cameras)
    pose = found.cameras[0].camera_from_world
    assert pose is not None
    assert pose.translation.tolist() == pytest.approx([-75.217911266918208, -108.95943925991841, 399.70206949907272])
    # the board's 9 x 6 corners, 25 mm apart, lie in the picture of every view
    board = 25.0 * np.array([[x, y, 0] for x in range(9) for y in range(6)])
    for named in found.cameras:
        assert named.camera_from_world is not None
        assert named.camera.sees(named.camera.project(named.camera_from_world @ board)).all()


def test_opencvs_stereo_pair_without_a_size(shared: Shared) -> None:
    found = read_cameras(shared("data/opencv_stereo_chess/intrinsics.yml"), size=(640, 480))
    assert [named.name for named in found.cameras] == ["M1", "M2"]
    assert found.cameras[1].camera.lens.parameters["k1"] == -0.16916358306948096


@pytest.mark.parametrize("folder", ["visp_franka_eye_in_hand", "visp_franka_eye_to_hand"])
def test_visps_camera_of_the_franka(shared: Shared, folder: str) -> None:
    found = read_cameras(shared(f"data/{folder}/franka_camera.xml"))
    assert found.format == "visp"
    (named,) = found.cameras
    assert named.camera.size == (640, 480)
    assert named.camera.fx == pytest.approx(607.593, abs=1e-3)
    assert isinstance(named.camera.lens, Ideal)  # kud is -0


@pytest.mark.parametrize(
    ("xml", "known"), [("teabox.xml", "camera_mono.json"), ("teabox_left.xml", "camera_left.json")]
)
def test_visps_teabox_cameras_are_those_of_their_json(shared: Shared, xml: str, known: str) -> None:
    """ViSP's tracker configurations hold the four numbers among others and no size; the json is a transcript."""
    truth = json.loads(shared(f"data/visp_teabox/{known}").read_text())
    path = shared(f"data/visp_teabox/{xml}")
    with pytest.raises(UnreadableFile, match="no picture size"):
        read_cameras(path)
    camera = read_cameras(path, size=(truth["width"], truth["height"])).cameras[0].camera
    assert [camera.fx, camera.fy, *camera.principal_point] == [truth[key] for key in ("fx", "fy", "cx", "cy")]
