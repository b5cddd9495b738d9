"""A scene file says what its keys say; models, cameras, poses and places come out as written."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import cadcam
from cadcam.cad.write import write_model
from cadcam.errors import UnreadableFile
from cadcam.plan.layout import plan_layout, survey
from cadcam.plan.scene.feature import Kind
from cadcam.plan.scene.file import read_layout_scene
from cadcam.plan.scene.layout_scene import CalibratedFrom, Sigmas
from cadcam.plan.scene.samples import write_samples
from cadcam.plan.scene.zones import arc, in_box
from cadcam.plan.sight.candidate import candidates, share_errors
from cadcam.verify.tolerances.tolerance import Quantity, Rule

from .scenes import MIDDLE, part, ring

TEXT = """\
part: {model: part.obj, unit: cm}
obstacles:
  - {model: part.obj, position_mm: [0, 5000, 0], rotation_deg: [0, 0, 90]}
poses:
  here: {position_mm: [0, 0, 0]}
  moved: {position_mm: [[-10, 10], 0, 0], rotation_deg: [0, 0, [0, 4]], steps: 2}
cameras:
  bought: {sensor: 1/2, pixels: [1600, 1200], focal_mm: 12, f_number: 4, focus_mm: 9000}
  own: {file: camera.json, sensor: IMX264, focal_mm: 16, f_number: 8}
mounts:
  wall: {box_mm: [[0, -9000, 0], [4000, -9000, 3000]], count: 12, aim_mm: [[2000, 1500, 500], [1000, 0, 500]]}
  robot: {arc: {center_mm: [2000, 1500, 3000], radius_mm: 8000, from_deg: 180, to_deg: 270}, count: 4, one_camera: true,
          cameras: [own]}
  post: {positions_mm: [[-5000, 0, 4000]], fixed: true, cameras: [bought], up: [0, 1, 0]}
features:
  top: {point_mm: [3150, 1150, 900], normal: [0, 0, 2], position_mm: 2, direction: [0, 0, 1], known_plane_mm: 0.5}
  hole: {circle_mm: [600, 800, 100], normal: [0, 0, 1], diameter_mm: 100, position_mm: 1, k: 3}
  post edges: {part: post, kinds: [crease], position_mm: 1, rule: simple acceptance}
  front: {edge_mm: [[200, 0, 100], [3800, 0, 100]], angle_deg: 0.1}
noise: {sigma_px: 0.1, gray: 0.02, contrast: 0.3, floor_px: 0.01, blur_px: 0.7}
calibration: {position_mm: 0.1, rotation_deg: 0.01, focal_px: 0.2, principal_point_px: 0.3}
motion: {position_mm: 0.2, rotation_deg: 0.02}
placement: {position_mm: 0.4}
seen: {incidence_deg: 82, blur_px: 3}
k: 2.5
tur: 4
choose: 2
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return a folder with a part of 4 x 3 m, a calibrated camera and the scene."""
    write_model(tmp_path / "part.obj", part())
    camera = cadcam.Camera.from_focal((2448, 2048), 4600.0)
    pose = cadcam.Rigid.look_at([0.0, -9000, 3000], MIDDLE)
    rng = np.random.default_rng(1)
    p = rng.uniform([0, 0, 0], [4000, 3000, 1200], (30, 3))
    q = camera.project(pose @ p) + rng.normal(0, 0.1, (30, 2))
    estimate = cadcam.calibrate_camera(cadcam.Observations(p, q, sigma_px=0.1), size=camera.size)
    cadcam.write_camera(tmp_path / "camera.json", estimate)
    (tmp_path / "scene.yaml").write_text(TEXT)
    return tmp_path


def test_every_key_is_read_as_it_says(folder: Path) -> None:
    scene = read_layout_scene(folder / "scene.yaml")
    np.testing.assert_allclose(scene.part.size_mm, [4000, 3000, 1200])
    assert scene.obstacles is not None
    np.testing.assert_allclose(scene.obstacles.bounds, [[-300, 5000, 0], [0, 5400, 120]], atol=1e-6)  # mm, its own unit
    assert list(scene.poses) == ["here", "moved 1", "moved 2", "moved 3", "moved 4"]
    np.testing.assert_allclose(scene.poses["moved 2"].translation, [-10, 0, 0])
    np.testing.assert_allclose(scene.poses["moved 2"].log()[3:], np.radians([0, 0, 4]))
    top, hole, edges, front = scene.features
    np.testing.assert_allclose(top.normal, [0, 0, 1])
    assert top.plane_mm == 0.5
    assert (hole.kind, hole.limits[0].k, edges.limits[0].rule) == (Kind.CIRCLE, 3.0, Rule.SIMPLE)
    assert edges.segments is not None
    assert len(edges.segments) == 8  # the four at its foot are contacts
    assert (front.limits[0].quantity, front.limits[0].k) == (Quantity.ANGLE, 2.5)
    assert front.limits[0].value == pytest.approx(np.radians(0.1))
    assert scene.calibration == Sigmas(0.1, np.radians(0.01), 0.2, 0.3)
    assert scene.seeing.incidence == pytest.approx(np.radians(82))
    assert (scene.tur, scene.choose, scene.finder.floor_px, scene.placement.position_mm) == (4.0, 2, 0.01, 0.4)
    assert [role for role, _, _ in scene.sources] == ["scene", "part", "camera", "obstacle"]


def test_candidates_are_places_by_aims_by_cameras(folder: Path) -> None:
    scene = read_layout_scene(folder / "scene.yaml")
    every = candidates(scene)
    assert len(every) == 12 * 2 * 2 + 4 + 1
    by_mount = {c.mount: c for c in every}
    assert by_mount["robot"].shared == "robot"
    assert by_mount["post"].fixed
    assert by_mount["post"].optics is not None
    assert by_mount["post"].optics.distance_mm == 9000
    np.testing.assert_allclose(by_mount["post"].aim, scene.part.bounds.mean(axis=0))  # where nothing is said
    own = by_mount["robot"].viewpoint
    estimate = scene.cameras["own"].estimate
    assert estimate is not None
    covariance = sum(D @ source.covariance @ D.T for source, D in own.errors)
    np.testing.assert_allclose(covariance[6:, 6:], (0.1**2 * estimate.cofactor)[6:, 6:])  # its own internals
    np.testing.assert_allclose(np.diag(own.errors[0][0].covariance)[:3], 0.1**2)  # its place, as assumed


def test_a_calibrated_camera_that_is_moved_is_that_of_measuring(folder: Path) -> None:
    scene = read_layout_scene(folder / "scene.yaml")
    first, second = [c for c in candidates(scene) if c.mount == "robot"][:2]
    motion = cadcam.KnownMotion(second.viewpoint.camera_from_world.inv @ first.viewpoint.camera_from_world)
    np.testing.assert_allclose(motion.new_from_old @ first.eye, second.eye, atol=1e-6)
    names = [source.name for source, _ in second.viewpoint.errors]
    assert names == ["calibration", "motion", "calibration"]  # of the place where it was calibrated; of its internals
    assert first.viewpoint.errors[0][0].owner is second.viewpoint.errors[0][0].owner
    # the motion's error is that of the place itself: sigma_mm of the focal centre, sigma_rad of the axes
    source, D = second.viewpoint.errors[1]
    local = D @ source.covariance @ D.T
    np.testing.assert_allclose(np.diag(local)[:3], 0.2**2, rtol=1e-6)
    np.testing.assert_allclose(np.diag(local)[3:6], np.radians(0.02) ** 2, rtol=1e-6)


def test_one_camera_file_is_one_calibration_at_every_mount(folder: Path) -> None:
    """Its internals err alike wherever it is used, under whatever name, and by that is what it measures judged."""
    (folder / "copy.json").write_bytes((folder / "camera.json").read_bytes())
    text = TEXT.replace("mounts:\n", "  copy: {file: copy.json}\nmounts:\n", 1)
    text = text.replace("cameras: [bought], up", "cameras: [copy], up")
    text = text.replace("calibration: {position_mm: 0.1, rotation_deg: 0.01, ", "calibration: {position_mm: 0.001, ")
    text = text.replace("motion: {position_mm: 0.2, rotation_deg: 0.02}", "motion: {position_mm: 0.001}")
    (folder / "scene.yaml").write_text(text)
    scene = read_layout_scene(folder / "scene.yaml")
    every = {c.name: c for c in candidates(scene)}
    some = [every[name] for name in ("wall 1 (own)", "wall 2 (own)", "robot 1", "post")]
    assert len({id(c.viewpoint.errors[-1][0].owner) for c in some}) == 1
    assert share_errors(some)
    assert not share_errors([every["wall 1 (own)"], every["wall 2 (bought)"]])

    rays = [c.viewpoint for c in some[:2]]
    apart = [replace(v, errors=[(replace(s, owner=object()), D) for s, D in v.errors]) for v in rays]
    middle = scene.part.bounds.mean(axis=0)
    together, alone = (cadcam.predict_points(views, middle[None]).covariance[0] for views in (rays, apart))
    assert not np.allclose(together, alone, rtol=0.01)
    seen = survey(scene)
    chosen = [i for i, c in enumerate(seen.candidates) if c.name in {c.name for c in some}]
    np.testing.assert_allclose(seen.ratios(chosen), seen.assess(chosen).ratio, rtol=1e-12)
    assert not np.allclose(seen.ratios(chosen).ravel(), seen.problem.ratios(chosen), rtol=1e-3)


def test_a_file_of_a_pose_alone_states_no_error_of_its_camera(folder: Path) -> None:
    """Its internals would be taken as exact, whatever the scene assumes of calibrations."""
    known = cadcam.read_camera(folder / "camera.json").estimate
    assert known is not None
    cadcam.write_camera(folder / "camera.json", cadcam.locate_camera(known.observations, known.camera))
    camera = next(c for c in candidates(read_layout_scene(folder / "scene.yaml")) if c.mount == "robot")
    ((source, _), *_) = camera.viewpoint.errors
    np.testing.assert_allclose(np.sqrt(np.diag(source.covariance))[[7, 9, 10]], [0.2, 0.3, 0.3])


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("count: 4, one_camera: true,", "count: 4,", "motion says how well .* set one_camera: true at a mount"),
        (", known_plane_mm: 0.5", "", "placement counts for features on known planes, and there are none; give a feat"),
        ("rotation_deg: [0, 0, [0, 4]]", "rotation_deg: [0, 0, 4]", ""),
        ("[[-10, 10], 0, 0], rotation_deg: [0, 0, [0, 4]]", "[-10, 0, 0], rotation_deg: [0, 0, 4]", "without a range"),
        ("normal: [0, 0, 2]", "normal: [0, 0, 2], diameter_mm: 9", "has diameter_mm beside point_mm"),
        ("{file: camera.json, sensor: IMX264", "{file: camera.json, sensor: IMX304", "4096 x 3000 of IMX304, and 2448"),
        ("{file: camera.json, sensor: IMX264", "{file: camera.json, sensor: 8.44x7.07", ""),
        ("IMX264, focal_mm: 16, f_number: 8", "IMX264, focal_mm: 16", "given in part"),
    ],
)  # fmt: skip
def test_keys_that_would_change_nothing_are_refused(folder: Path, old: str, new: str, said: str) -> None:
    """Whoever writes one expects that it counts; without `said` it does."""
    assert TEXT.count(old) == 1
    (folder / "scene.yaml").write_text(TEXT.replace(old, new))
    if not said:
        assert read_layout_scene(folder / "scene.yaml").choose == 2
        return
    with pytest.raises(cadcam.CadcamError, match=said):
        read_layout_scene(folder / "scene.yaml")


_BARE = """\
part: {model: part.obj, unit: cm}
cameras: {own: {file: camera.json}}
mounts: {wall: {box_mm: [[0, -9000, 0], [4000, -9000, 3000]], count: 12}}
features: {top: {point_mm: [3150, 1150, 900], position_mm: 2}}
noise: {sigma_px: 0.1}
"""


@pytest.mark.parametrize(
    ("key", "needs"),
    [
        ("calibration: {focal_px: 0.2}", "cameras: {own: {sensor: IMX264, focal_mm: 16}}"),
        ("calibration: {principal_point_px: 0.2}", "cameras: {own: {sensor: IMX264, focal_mm: 16}}"),
        ("noise: {sigma_px: 0.1, blur_px: 0.7}", "cameras: {own: {sensor: IMX264, focal_mm: 16, f_number: 8}}"),
        ("seen: {blur_px: 3}", "cameras: {own: {sensor: IMX264, focal_mm: 16, f_number: 8}}"),
        ("seen: {share: 0.5}", "features: {top: {edge_mm: [[200, 0, 100], [3800, 0, 100]], position_mm: 2}}"),
        ("seen: {least_px: 3}", "features: {top: {edge_mm: [[200, 0, 100], [3800, 0, 100]], position_mm: 2}}"),
        (
            "noise: {sigma_px: 0.1, gray: 0.01, contrast: 0.3}",
            "features: {top: {edge_mm: [[200, 0, 100], [3800, 0, 100]], position_mm: 2}}",
        ),
    ],
)
def test_assumptions_on_what_is_not_there_are_refused(folder: Path, key: str, needs: str) -> None:
    def written(*lines: str) -> Path:
        keys = {line.partition(":")[0]: line for line in (*_BARE.splitlines(), *lines)}
        (folder / "scene.yaml").write_text("\n".join(keys.values()))
        return folder / "scene.yaml"

    read_layout_scene(written(key, needs))
    name = key.partition(": {")[0] + "." + re.findall(r"(\w+): [\d.]+", key)[-1 if "noise" not in key else 1]
    with pytest.raises(cadcam.CadcamError, match=rf"{name} .*, or leave it out"):
        read_layout_scene(written(key))


def test_edges_of_a_part_are_measured_in_all_directions(folder: Path) -> None:
    scene = read_layout_scene(folder / "scene.yaml")
    seen = survey(scene)
    i = [f.name for f in scene.features].index("post edges")
    sees = [c for c, view in enumerate(seen.visibility) if view.seen[:, i].all()]
    found = seen.assess(sees[:6])
    limit = int(np.flatnonzero(seen.asked.feature == i)[0])
    assert np.isfinite(found.sigma[:, limit]).all()
    np.testing.assert_allclose(seen.asked.basis[limit], np.eye(3))


def test_a_box_and_an_arc_hold_what_was_asked_for() -> None:
    for box, count in (([[0, 0, 0], [100, 50, 20]], 30), ([[0, 0, 5], [100, 0, 5]], 7), ([[1, 2, 3], [1, 2, 3]], 9)):
        places = in_box(np.array(box, float), count)
        assert 1 <= len(places) <= count
        assert len(np.unique(places, axis=0)) == len(places)
        assert (places >= box[0]).all()
        assert (places <= box[1]).all()
        assert len(places) > count / 3 or len(places) == 1
    for start, end in ((0.0, 720.0), (90.0, 90.0)):  # places one upon the other
        with pytest.raises(cadcam.CadcamError, match="at most 360 deg apart"):
            arc(np.zeros(3), 10.0, start, end, 5, axis=np.array([0.0, 0, 1]))
    places = arc(np.array([1.0, 2, 3]), 10.0, 0.0, 360.0, 8, axis=np.array([0.0, 0, 2]))
    np.testing.assert_allclose(np.linalg.norm(places - [1, 2, 3], axis=1), 10)
    assert len(np.unique(np.round(places, 6), axis=0)) == 8
    np.testing.assert_allclose(places[0], [11, 2, 3])
    np.testing.assert_allclose(places[2], [1, 12, 3], atol=1e-9)


def test_the_samples_are_planned_as_their_headlines_say(tmp_path: Path) -> None:
    _, fixed, robot = write_samples(tmp_path)
    four, six = read_layout_scene(fixed), read_layout_scene(robot)
    assert four.calibration == CalibratedFrom(40, 0.1, 0.1)
    layout = plan_layout(four)
    assert layout.outcome.value == "SUITABLE"
    assert len(layout.chosen) == 4
    assert all(4500 < np.linalg.norm(c.eye - c.aim) < 7500 for c in layout.cameras)
    moved = plan_layout(six)
    assert len(moved.chosen) == 6
    assert {c.shared for c in moved.cameras} == {"robot"}
    assert moved.assessment.shares["motion"].max() > 0.9  # what limits a carried camera is how it is carried


def test_wrong_yaml_names_its_line(tmp_path: Path) -> None:
    path = tmp_path / "scene.yaml"
    path.write_text("part: [\n")
    with pytest.raises(UnreadableFile, match="is not YAML"):
        read_layout_scene(path)


def test_a_ring_is_aimed_at_its_middle() -> None:
    for eye in ring(4).eyes:
        pose = cadcam.Rigid.look_at(eye, MIDDLE)
        np.testing.assert_allclose((pose @ MIDDLE)[:2], 0, atol=1e-9)
