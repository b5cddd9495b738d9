"""A script's mistakes are told at the function that it calls: what was given, and what is expected."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import cadcam
from cadcam.arrays import frozen
from cadcam.cad.parts.shape import box

from .plan import scenes

CAMERA = cadcam.Camera.from_focal((80, 60), 90.0)
SCENE = cadcam.Scene.of(box((0, 0, 0), (300, 200, 100), name="box"))
POSE = cadcam.Rigid.look_at((700, -500, 600), (150, 100, 50))
P = np.random.default_rng(3).uniform(-200, 200, (12, 3))
POINTS = cadcam.Observations(P, CAMERA.project(cadcam.Rigid.look_at((0, -900, 400), (0, 0, 0)) @ P))
ESTIMATE = cadcam.PoseEstimate(POSE, np.eye(6))
GRAY = np.linspace(0.1, 0.9, 4800).reshape(60, 80)
VIEWPOINT = cadcam.Viewpoint.exact("left", CAMERA, POSE, sigma_px=0.1)
OPTICS = cadcam.SensorFormat("own", (8.0, 6.0))
PART = cadcam.Part(SCENE)
PHOTO = cadcam.Photo.of(GRAY, CAMERA, POSE)
PLAN = cadcam.DatasetPlan(1, CAMERA)
MASKED = np.ma.masked_less(GRAY, 0.2)


def layout(**changed: Any) -> cadcam.LayoutScene:
    """Return the scene of a layout with one thing changed."""
    return replace(scenes.scene(2), **changed)


WRONG: dict[str, tuple[Callable[[Path], object], str]] = {
    "a path of None": (lambda _: cadcam.write_cameras(None, CAMERA), "path is None; expected the name of a file"),
    "a path of bytes": (lambda _: cadcam.read_cameras(b"x.yaml"), "path is a bytes; expected the name of a file"),
    "poses from None": (lambda _: cadcam.read_poses(None), "path is None; expected the name of a file"),
    "robot poses from None": (lambda _: cadcam.read_robot_poses(None, convention="kuka"), "path is None"),
    "a name with NUL": (lambda _: cadcam.read_model("a\0.ply"), "path is the text .*; expected a name without NUL"),
    "a store with NUL": (lambda _: cadcam.open_store("a\0.db"), "store is the text .*; expected a name without NUL"),
    "a sensor's name": (lambda _: cadcam.named_sensor(None), "sensor is None; expected the name of a file"),
    "a sensor's size": (lambda _: cadcam.sensor_format(7), "sensor is 7; expected a str"),
    "no sensor": (lambda to: cadcam.write_sensor(to / "s.json", CAMERA), "sensor is a Camera; expected a Sensor"),
    "poses that are none": (lambda to: cadcam.write_poses(to / "p.csv", {"a": 1}), "pose 'a' is 1; expected a Rigid"),
    "viewpoints": (
        lambda to: cadcam.write_part_pose(to / "p.json", ESTIMATE, viewpoints="left"),
        "viewpoints is the text 'left'; expected a list, each a Viewpoint",
    ),
    "a model's path": (
        lambda to: cadcam.write_part_pose(to / "p.json", ESTIMATE, model="part.step"),
        "model is the text 'part.step'; expected a Mapping",
    ),
    "one name of two": (
        lambda to: cadcam.write_pick_page(to / "p.html", GRAY, SCENE, names=("photo",)),
        "names is a tuple of 1; expected two",
    ),
    "a quality": (
        lambda to: cadcam.write_picture(to / "p.jpg", GRAY, quality="high"),
        "quality is the text 'high'; expected a whole number from 1 to 100",
    ),
    "a title": (
        lambda to: cadcam.write_overlay_svg(to / "o.svg", cadcam.visible_wireframe(SCENE, CAMERA, POSE), title=7),
        "title is 7; expected a str",
    ),
    "a gap": (lambda _: cadcam.side_by_side(GRAY, gap=-1), "gap is -1; expected a whole number from 0 to"),
    "a fixed value": (
        lambda _: cadcam.calibrate_camera(POINTS, (80, 60), fixed={"skew": None}),
        "fixed skew is None; expected a number",
    ),
    "a focal length": (
        lambda _: cadcam.solve_optics(OPTICS, focal_mm=np.ones(2), distance_mm=900.0),
        r"focal_mm is an array of shape \(2,\); expected a positive number, mm",
    ),
    "sigma_px": (lambda _: cadcam.Observations(P, P[:, :2], sigma_px="0.1"), "sigma_px is the text '0.1'; expected a"),
    "what is seen": (
        lambda _: cadcam.predict_points([VIEWPOINT] * 2, np.zeros((2, 3)), seen=[[True, False], [True]]),
        "seen is .*; expected numbers of shape",
    ),
    "a colour alone": (lambda _: cadcam.repaint(SCENE, None), "chosen is None; expected pairs such as"),
    "a unit": (
        lambda _: cadcam.robot_poses([1, 2, 3, 4, 5, 6], convention="kuka", unit=1),
        "unit is 1; expected a str",
    ),
    "a depth": (
        lambda _: cadcam.LineOptions(near_mm=float("nan")),
        "near_mm is nan; expected a length in mm, at least",
    ),
    "a thickness": (lambda _: cadcam.LineOptions(coincident_mm=-1), "coincident_mm is -1; expected a length in mm, at"),
    "allowed losses": (
        lambda to: cadcam.write_cameras(to / "c.yaml", CAMERA, format_name="opencv", allow_loss="lens"),
        r"allow_loss is the text 'lens'; expected a list of names: \['lens'\]",
    ),
    "options of templates": (
        lambda _: cadcam.match_templates(PART, [PHOTO], POSE, options=0.3),
        "options is 0.3; expected a TemplateOptions",
    ),
    "a seed": (lambda _: cadcam.match_templates(PART, [PHOTO], POSE, rng=1), "rng is 1; expected a Generator: numpy"),
    "no photos": (lambda _: cadcam.match_templates(PART, [], POSE), "photos is none; expected at least one"),
    "what is told": (
        lambda _: cadcam.verify_part(PART, [PHOTO], cadcam.Location.nowhere(POSE, ""), cadcam.Tolerances(), tell="x"),
        "tell is the text 'x'; expected a function",
    ),
    "a freedom": (lambda _: list(cadcam.track_part(PART, [], POSE, freedom=6)), "freedom is 6; expected a Freedom"),
    "one frame": (
        lambda _: list(cadcam.track_part(PART, cadcam.Frame.of(0, PHOTO), POSE)),
        r"frames is a Frame; expected a list of them: \[frames\]",
    ),
    "no history": (lambda _: list(cadcam.track_part(PART, [], POSE, history=None)), "history is None; expected a list"),
    "no sources": (lambda _: cadcam.Frames(None, [VIEWPOINT]), "sources is None; expected a list, each a str or"),
    "no poses": (
        lambda _: list(cadcam.open_renderer(SCENE).render_batch(CAMERA, None)),
        "poses is None; expected a list, each a Rigid",
    ),
    "no poses of rays": (
        lambda _: list(cadcam.open_renderer(SCENE, "ray").render_batch(CAMERA, 7)),
        "poses is 7; expected a list, each a Rigid",
    ),
    "a gap of a terapixel": (lambda _: cadcam.side_by_side(GRAY, gap=2**40), "gap is 1099511627776; expected a whole"),
    "a scene of None": (lambda _: cadcam.Scene(None, SCENE.edges, SCENE.colors), "mesh is None; expected a Mesh"),
    "no edges": (lambda _: cadcam.Scene(SCENE.mesh, None, SCENE.colors), "edges is None; expected a FeatureEdges"),
    "paint": (
        lambda _: cadcam.Scene(SCENE.mesh, SCENE.edges, SCENE.colors, 7),
        r"paint is of shape \(\); expected shape",
    ),
    "errors of a view": (
        lambda _: cadcam.Viewpoint("a", CAMERA, POSE, 0.1, errors=[np.eye(2)]),
        r"errors\[0\] is an array of shape \(2, 2\); expected an ErrorSource with its effect",
    ),
    "a step": (lambda _: cadcam.plan_layout(layout(), step=1), "step is 1; expected a function"),
    "poses of a layout": (lambda _: layout(poses=[POSE]), "poses is a list of 1; expected a Mapping"),
    "a pose of a layout": (lambda _: layout(poses={"a": None}), r"poses\['a'\] is None; expected a Rigid"),
    "a name of a pose": (lambda _: layout(poses={7: POSE}), "a name in poses is 7; expected a str"),
    "mounts": (lambda _: layout(mounts="ring"), "mounts is the text 'ring'; expected a list, each a Mount"),
    "features": (lambda _: layout(features=[None]), r"features\[0\] is None; expected a LayoutFeature"),
    "no finder": (lambda _: layout(finder=0.1), "finder is 0.1; expected a Finder"),
    "a name of a plate": (
        lambda _: cadcam.Plate(P[:2, :2], P[:2, :2], mark_names=(1, 2)),
        r"mark_names\[0\] is 1; expected a str",
    ),
    "no station": (
        lambda _: cadcam.measure_marks({"6": None}, []),
        r"stations\['6'\] is None; expected a GantryCalibration",
    ),
    "views of a rig": (
        lambda _: cadcam.RigCamera([GRAY], (80, 60)),
        r"views\[0\] is an array of shape \(60, 80\); expected an Observations",
    ),
    "a split": (lambda to: cadcam.make_dataset(to, SCENE, PLAN, split=7), "split is 7; expected a str"),
    "a folder": (lambda _: cadcam.make_dataset(None, SCENE, PLAN), "folder is None; expected the name of a file"),
    "a name": (lambda to: cadcam.make_dataset(to, SCENE, PLAN, name=None), "name is None; expected a str"),
    "a callback": (lambda to: cadcam.make_dataset(to, SCENE, PLAN, on_view=1), "on_view is 1; expected a function"),
    "a model's hash": (
        lambda to: cadcam.write_part_pose(to / "p.json", ESTIMATE, model={"sha256": float("nan")}),
        r"model\['sha256'\] is nan; expected a str",
    ),
    "a dash": (lambda _: cadcam.LineStyle(dash=(-1, 2)), r"dash is \(-1, 2\); expected \(on, off\) lengths above 0"),
    "a width": (lambda _: cadcam.LineStyle(width=0), "width is 0; expected a line width above 0"),
    "a hidden width": (lambda _: cadcam.LineStyle(hidden_width=-1), "hidden_width is -1; expected a line width above"),
    "an opacity": (lambda _: cadcam.LineStyle(hidden_opacity=2), "hidden_opacity is 2; expected 0"),
    "a colour": (lambda _: cadcam.LineStyle(color=(2, 0, 0)), r"color is \(2, 0, 0\); expected red, green, blue"),
    "a colour of a kind": (
        lambda _: cadcam.LineStyle(kinds={cadcam.EdgeKind.CREASE: "red"}),
        "color of CREASE is 'red'; expected numbers of shape",
    ),
    "a masked picture": (lambda _: cadcam.Photo.of(MASKED, CAMERA), "picture is masked in places; expected every"),
    "masked points": (lambda _: cadcam.Observations(np.ma.masked_less(P, 0), P[:, :2]), "world points is masked in"),
    "a difference": (
        lambda _: cadcam.to_gray((GRAY * 300).astype(np.int16) - 300),
        "picture is of whole numbers down to -270; expected 0 or more",
    ),
}


BOTH = np.array([True, False])
FLAGS: dict[str, Callable[[Any, Path], object]] = {
    "contacts": lambda flag, _: cadcam.feature_edges(SCENE.mesh, contacts=flag),
    "smooth_seams": lambda flag, _: cadcam.feature_edges(SCENE.mesh, smooth_seams=flag),
    "hidden": lambda flag, _: cadcam.LineOptions(hidden=flag),
    "either_sign": lambda flag, _: cadcam.CorrelateOptions(either_sign=flag),
    "perspective": lambda flag, _: cadcam.MarkOptions(perspective=flag),
    "wider": lambda flag, _: cadcam.refine_pose(PART, [PHOTO], cadcam.Rigid(), wider=flag),
    "texture": lambda flag, _: list(cadcam.track_part(PART, [], texture=flag)),
    "velocity": lambda flag, to: list(
        cadcam.track_part_to_log(to / "l.jsonl", PART, cadcam.Frames([to], [VIEWPOINT]), velocity=flag)
    ),
    "bend": lambda flag, _: cadcam.calibrate_jointly([POINTS], (80, 60), bend=flag),
    "keep_all": lambda flag, _: cadcam.calibrate_boards([], keep_all=flag),
    "rotate": lambda flag, _: cadcam.compare_cameras(CAMERA, CAMERA, rotate=flag),
    "fit": lambda flag, to: cadcam.write_cameras(to / "c.yaml", CAMERA, format_name="opencv", fit=flag),
    "inverted": lambda flag, to: cadcam.read_robot_poses(to / "r.csv", convention="kuka", inverted=flag),
    "create": lambda flag, to: cadcam.open_store(to / "s.db", create=flag),
}


@pytest.mark.parametrize("flag", ["no", None, BOTH], ids=["text", "none", "array"])
@pytest.mark.parametrize("name", FLAGS)
def test_what_is_neither_true_nor_false_is_no_flag(name: str, flag: object, tmp_path: Path) -> None:
    cadcam.write_picture(tmp_path / "1.png", GRAY)
    with pytest.raises(cadcam.CadcamError, match=f"^{name} is .*; expected True or False$"):
        FLAGS[name](flag, tmp_path)


@pytest.mark.parametrize("wrong", WRONG)
def test_a_wrong_argument_is_named(wrong: str, tmp_path: Path) -> None:
    call, words = WRONG[wrong]
    with pytest.raises(cadcam.CadcamError, match=f"^{words}"):
        call(tmp_path)


def test_numbers_of_any_size_of_numpys_do(rng: np.random.Generator) -> None:
    """Counts and numbers of few bits are calculated with as Python's, which do not overflow."""
    estimate = cadcam.calibrate_camera(POINTS, (80, 60), fixed={"skew": np.int8(0)})
    assert cadcam.projection_map(estimate, nodes=np.int8(60)).x.shape == (60,)
    drawn = cadcam.monte_carlo_variability(estimate, rng=rng, draws=np.float32(5), sigma_px=0.1)
    assert drawn.draws.shape[1] == 5


def test_what_a_mask_leaves_is_taken() -> None:
    """Without a masked place a masked array is an array."""
    np.testing.assert_array_equal(frozen(np.ma.masked_array(P), "points", (None, 3)), P)
