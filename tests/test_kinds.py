"""What a script gets wrong is one error: which argument, what was given, and the way to what is asked for."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

import cadcam
from cadcam.cad.parts import machined_bracket
from cadcam.errors import BadValue
from cadcam.kinds import expect, expect_each, expect_names, said
from cadcam.verify.tolerances.verdict import Verdict

SIZE = (160, 120)
PICTURE = np.tile(np.linspace(0, 1, 160, dtype=np.float32), (120, 1))
ORIGIN = cadcam.VerificationOrigin("part")
VERIFIED = cadcam.Verification(
    Verdict.NOT_FOUND, "", (), None, cadcam.Tolerances(), cadcam.Location.nowhere(cadcam.Rigid(), "")
)


class Things(NamedTuple):
    """One valid thing of each kind; calls below exchange one of them. Any: they are given where they do not belong."""

    camera: Any
    pose: Any
    batch: Any
    mesh: Any
    scene: Any
    part: Any
    photo: Any
    wires: Any
    view: Any
    points: Any
    estimate: Any
    renderer: Any
    located: Any
    pattern: Any


def _added_as_a_list(record: cadcam.Record) -> None:
    with cadcam.open_store(":memory:") as store:
        store.add([record])


@pytest.fixture(scope="module")
def things() -> Things:
    mesh = machined_bracket()
    scene = cadcam.Scene.of(mesh)
    camera, pose = cadcam.standard_view(mesh, size=SIZE)
    renderer = cadcam.open_renderer(scene, threads=1)
    corners = np.array([[x, y, z] for x in (0.0, 80) for y in (0.0, 60) for z in (0.0, 40)])
    noise = np.random.default_rng(1).normal(scale=0.1, size=(8, 2))
    points = cadcam.Observations(corners, camera.project(pose @ corners) + noise)
    return Things(
        camera=camera,
        pose=pose,
        batch=cadcam.Rigid.exp(np.zeros((2, 6))),
        mesh=mesh,
        scene=scene,
        part=cadcam.Part(scene),
        photo=cadcam.Photo.of(PICTURE, camera),
        wires=cadcam.visible_wireframe(scene, camera, pose),
        view=renderer.render(camera, pose),
        points=points,
        estimate=cadcam.locate_camera(points, camera),
        renderer=renderer,
        located=cadcam.Location.nowhere(pose, "nothing there"),
        pattern=cadcam.parse_pattern("chessboard:9x6:25mm"),
    )


WRONG: dict[str, tuple[Callable[[Things], object], str]] = {
    # in place of a Part, a Photo, a Scene, a Mesh
    "locate, mesh": (lambda t: cadcam.locate_part(t.mesh, [t.photo], t.pose), "part is a Mesh.*Part.of"),
    "locate, path": (
        lambda t: cadcam.locate_part("a.step", [t.photo], t.pose),
        "part is the text.*read_model",
    ),
    "locate, one photo": (lambda t: cadcam.locate_part(t.part, t.photo, t.pose), r"photos is a Photo.*\[photos\]"),
    "locate, array": (
        lambda t: cadcam.locate_part(t.part, [PICTURE], t.pose),
        r"photos\[0\] is an array of shape \(120, 160\).*Photo.of",
    ),
    "locate, views": (lambda t: cadcam.locate_part(t.part, [t.photo], views="above"), "ViewRange.above"),
    "refine, scene": (lambda t: cadcam.refine_pose(t.scene, [t.photo], t.pose), "part is a Scene.*cadcam.Part"),
    "match, no start": (lambda t: cadcam.match_templates(t.part, [t.photo], None), "start is None.*a Rigid"),
    "track, photos": (lambda t: list(cadcam.track_part(t.part, [t.photo], t.pose)), "frame is a Photo.*a Frame"),
    "frames, arrays": (lambda t: cadcam.Frames([PICTURE], [t.photo.viewpoint]), r"sources\[0\] is an array.*Frame.of"),
    "frames, camera": (lambda t: cadcam.Frames(["a"], [t.camera]), r"viewpoints\[0\] is a Camera.*Viewpoint.exact"),
    "verify, pose": (lambda t: cadcam.verify_part(t.part, [t.photo], t.pose, None), "located is a Rigid.*a Location"),
    "verify, file": (
        lambda t: cadcam.verify_part(t.part, [t.photo], t.located, "t.yaml"),
        "tolerances is the text 't.yaml'.*read_tolerances",
    ),
    "scene of path": (lambda t: cadcam.Scene.of("a.stl"), "mesh is the text.*read_model"),
    "part of part": (lambda t: cadcam.Part.of(t.part), "mesh is a Part.*its .scene.mesh"),
    "renderer of mesh": (lambda t: cadcam.open_renderer(t.mesh), "scene is a Mesh.*Scene.of"),
    "wires of mesh": (lambda t: cadcam.visible_wireframe(t.mesh, t.camera, t.pose), "scene is a Mesh.*Scene.of"),
    "whole parts of part": (lambda t: cadcam.whole_parts(t.part), "scene is a Part.*its .scene"),
    "edges of scene": (lambda t: cadcam.feature_edges(t.scene), "mesh is a Scene.*its .mesh"),
    # in place of a camera or a pose
    "photo, file": (lambda t: cadcam.Photo.of(PICTURE, cadcam.CameraFile(t.camera)), "a CameraFile.*calibrated"),
    "photo, K": (lambda t: cadcam.Photo.of(PICTURE, t.camera.K), r"camera is an array.*cadcam.Camera\(size, K"),
    "photo, 4x4": (lambda t: cadcam.Photo.of(PICTURE, t.camera, t.pose.matrix), "camera_from_world.*from_matrix"),
    "photo, array as viewpoint": (lambda t: cadcam.Photo(PICTURE, t.camera), "viewpoint is a Camera"),
    "wires, exchanged": (lambda t: cadcam.visible_wireframe(t.scene, t.pose, t.camera), "camera is a Rigid"),
    "wires, estimate": (lambda t: cadcam.visible_wireframe(t.scene, t.estimate, t.pose), "its .camera"),
    "wires, batch": (lambda t: cadcam.visible_wireframe(t.scene, t.camera, t.batch), "a single motion"),
    "render, exchanged": (lambda t: t.renderer.render(t.pose, t.camera), "camera is a Rigid"),
    "render, location": (lambda t: t.renderer.render(t.camera, t.located), "its .pose.world_from_part"),
    "render, channels": (lambda t: t.renderer.render(t.camera, t.pose, channels="depth"), "channels is the text"),
    "render, look": (lambda t: t.renderer.render(t.camera, t.pose, look="steel"), "look is the text.*named_look"),
    "render, matrices": (
        lambda t: list(t.renderer.render_batch(t.camera, [t.pose.matrix])),
        "camera_from_world is an array of shape.*from_matrix",
    ),
    "start, matrix": (lambda t: cadcam.locate_part(t.part, [t.photo], t.pose.matrix), "start is an array.*from_matrix"),
    "start, pose": (lambda t: cadcam.locate_part(t.part, [t.photo], t.located.pose), "its .world_from_part"),
    "start, batch": (lambda t: cadcam.locate_part(t.part, [t.photo], t.batch), "a single motion"),
    "compare estimates": (lambda t: cadcam.compare_cameras(t.camera, t.estimate), "b is a CameraEstimate.*its .camera"),
    "view of estimates": (lambda t: cadcam.measure_points([t.estimate], []), "Viewpoint.fixed"),
    "fixed camera": (lambda t: cadcam.Viewpoint.fixed("a", t.camera), "estimate is a Camera"),
    "lens, list": (lambda t: cadcam.Camera(SIZE, t.camera.K, [0.1, 0.2]), "lens is a list of 2.*from_opencv"),
    "lens, numbers": (lambda t: cadcam.BrownConrady([0.1, 0.2]), r"coefficient k1 is a list of 2.*given as \*list"),
    "lens, none": (lambda t: cadcam.BrownConrady(None), "coefficient k1 is None"),
    # points and observations
    "calibrate path": (lambda t: cadcam.calibrate_camera("a.csv", SIZE), "the text 'a.csv'.*read_points"),
    "calibrate lists": (lambda t: cadcam.calibrate_camera([[1, 2, 3]], SIZE), "cadcam.Observations"),
    "calibrate, class": (
        lambda t: cadcam.calibrate_camera(t.points, SIZE, lens=cadcam.BrownConrady),
        "lens is the class BrownConrady.*an instance",
    ),
    "calibrate, name": (
        lambda t: cadcam.calibrate_camera(t.points, SIZE, lens=cadcam.BrownConrady(), free_lens="k1"),
        r"free_lens is the text 'k1'.*\['k1'\]",
    ),
    "calibrate, turned": (lambda t: cadcam.calibrate_camera(t.points, (105, 160)), r"\(160, 105\): \(width, height\)"),
    "jointly, turned": (lambda t: cadcam.calibrate_jointly([t.points], (105, 160)), r"\(160, 105\): \(width, height\)"),
    "calibrate, width": (lambda t: cadcam.calibrate_camera(t.points, 160), "picture size is 160"),
    "jointly, one": (lambda t: cadcam.calibrate_jointly(t.points, SIZE), r"views is an Observations.*\[views\]"),
    "resection, exchanged": (lambda t: cadcam.locate_camera(t.camera, t.points), "observations is a Camera"),
    "hand-eye, list": (
        lambda t: cadcam.calibrate_hand_eye([t.pose], [t.points], t.camera, mounting="eye-in-hand"),
        "base_from_flange is a list of 1.*Rigid.stack",
    ),
    "hand-eye, pictures": (
        lambda t: cadcam.calibrate_hand_eye(
            t.batch, [cadcam.find_board(PICTURE, t.pattern)], t.camera, mounting="eye-in-hand"
        ),
        r"observations\[0\] is a BoardPicture.*board_views",
    ),
    "boards, paths": (lambda t: cadcam.calibrate_boards(["a.png"]), r"pictures\[0\] is the text.*find_board"),
    "board, text": (lambda t: cadcam.find_board(PICTURE, "chessboard:9x6:25mm"), "parse_pattern"),
    "board, none": (lambda t: cadcam.parse_pattern(None), "board is None"),
    "marks, text": (lambda t: cadcam.find_marks(PICTURE, "disc:10mm"), "parse_mark"),
    "sigma, list": (lambda t: cadcam.Observations(t.points.p_world, t.points.q, sigma_px=[1.0]), "one for all points"),
    # numbers of the wrong shape
    "project pixels": (lambda t: t.camera.project([[1.0, 2.0]]), r"points is a list of 1.*\(\.\.\., 3\)"),
    "project none": (lambda t: t.camera.project(None), "points is None"),
    "unproject points": (lambda t: t.camera.unproject(np.zeros((5, 3))), r"pixels is an array of shape \(5, 3\)"),
    "move pixels": (lambda t: t.pose @ np.zeros((5, 2)), r"right of @ is an array of shape \(5, 2\)"),
    "move a matrix": (lambda t: t.pose @ np.eye(4), "right of @ is an array.*from_matrix"),
    "matrix moves": (lambda t: np.eye(4) @ t.pose, "left of @ is an array.*from_matrix"),
    "move words": (lambda t: t.pose @ "abc", "right of @ is the text 'abc'"),
    "matrix of words": (lambda t: cadcam.Rigid.from_matrix("abc"), "rigid motion is the text 'abc'"),
    "stack of matrices": (lambda t: cadcam.Rigid.stack([np.eye(4)]), r"motions\[0\] is an array"),
    # drawing and files
    "overlay, exchanged": (lambda t: cadcam.overlay(t.wires, PICTURE), "wireframe is an array"),
    "overlay, view": (lambda t: cadcam.overlay(PICTURE, t.view), "wireframe is a View.*visible_wireframe"),
    "blend, array": (lambda t: cadcam.blend_pictures(PICTURE, PICTURE), "view is an array.*render"),
    "distances, scene": (lambda t: cadcam.edge_distances(PICTURE, t.scene), "wireframe is a Scene"),
    "view, mesh": (lambda t: cadcam.standard_view(t.scene), "mesh is a Scene.*its .mesh"),
    "view, width": (lambda t: cadcam.standard_view(t.mesh, size=800), "picture size is 800"),
    "repaint mesh": (lambda t: cadcam.repaint(t.mesh, []), "scene is a Mesh"),
    "write picture": (lambda t: cadcam.write_picture(PICTURE, "a.png"), "path is an array.*a str or a pathlib.Path"),
    "write model": (lambda t: cadcam.write_model(t.mesh, "a.stl"), "path is a Mesh"),
    "write scene": (lambda t: cadcam.write_model("a.stl", t.scene), "mesh is a Scene"),
    "write camera": (lambda t: cadcam.write_camera(t.camera, "a.json"), "path is a Camera"),
    "write K": (lambda t: cadcam.write_camera("a.json", t.camera.K), "camera is an array"),
    "write pose": (lambda t: cadcam.write_part_pose("a.json", t.located), "pose is a Location.*its .pose"),
    "write points": (lambda t: cadcam.write_points("a.csv", t.points.q), "observations is an array"),
    "write measured": (lambda t: cadcam.write_measurement("a.csv", PICTURE), "measured is an array"),
    "read none": (lambda t: cadcam.read_model(None), "path is None"),
    "read picture": (lambda t: cadcam.read_picture(PICTURE), "path is an array"),
    "read points": (lambda t: cadcam.read_points(3), "path is 3"),
    # records, plans, chance
    "record of location": (lambda t: cadcam.record_of(t.located, ORIGIN), "found is a Location; expected a Verif"),
    "page of a name": (
        lambda t: cadcam.write_verification_page("a.html", VERIFIED, [t.photo], "part"),
        "origin is the text 'part'.*VerificationOrigin",
    ),
    "page of one photo": (
        lambda t: cadcam.write_verification_page("a.html", VERIFIED, t.photo, ORIGIN),
        r"photos is a Photo.*\[photos\]",
    ),
    "records, one": (lambda t: cadcam.write_records("a.json", cadcam.Record("part")), r"a Record.*\[records\]"),
    "records, verified": (lambda t: cadcam.write_records("a.json", [VERIFIED]), r"records\[0\].*record_of"),
    "store, none": (lambda t: cadcam.open_store(None), "store is None"),
    "layout of a path": (lambda t: cadcam.plan_layout("a.yaml", 3), "scene is the text.*read_layout_scene"),
    "data set, camera": (lambda t: cadcam.DatasetPlan(2, t.estimate), "camera is a CameraEstimate.*its .camera"),
    "data set, number": (lambda t: cadcam.DatasetPlan("2", t.camera), "views is the text '2'"),
    "radiance, light": (
        lambda t: cadcam.Photographer(t.scene).radiance(t.camera, t.pose, light="hall"),
        "light is the text 'hall'.*named_light",
    ),
    "optics, sensor": (lambda t: cadcam.solve_optics("1/2", focal_mm=8, distance_mm=900), "sensor_format"),
    "sensor, seed": (lambda t: cadcam.named_sensor("phone").apply(PICTURE, rng=1), "rng is 1.*default_rng"),
    "draws, seed": (lambda t: cadcam.monte_carlo_variability(t.estimate, rng=1), "rng is 1.*default_rng"),
    "map of a camera": (lambda t: cadcam.projection_map(t.camera), "estimate is a Camera"),
    "advice on an estimate": (lambda t: cadcam.nested_advice(t.estimate), "fit is a CameraEstimate"),
    "rig of a list": (lambda t: cadcam.calibrate_rig_boards([[], []]), "pictures is a list of 2.*by name"),
    "rig of cameras": (lambda t: cadcam.calibrate_rig({"": t.camera}), r"cameras\[''\] is a Camera.*RigCamera\(views"),
    "reach, number": (lambda t: cadcam.locate_part(t.part, [t.photo], t.pose, reach=30), "reach is 30.*cadcam.Reach"),
    "options, dict": (
        lambda t: cadcam.refine_pose(t.part, [t.photo], t.pose, options={"search_px": 9}),
        "options is a dict of 1.*cadcam.EdgeOptions",
    ),
    # numbers and names
    "focal length, list": (lambda t: cadcam.Camera.from_focal(SIZE, [300.0]), "fx is a list of 1; expected a number"),
    "opacity, text": (lambda t: cadcam.blend_pictures(PICTURE, t.view, opacity="half"), "opacity is the text 'half'"),
    "sigma_px, none": (
        lambda t: cadcam.Viewpoint.exact("a", t.camera, t.pose, sigma_px=None),
        "pixel noise of viewpoint 'a' is None; expected a positive number of px",
    ),
    "motion, list": (
        lambda t: cadcam.KnownMotion(t.pose).known_to([0.1], 0.0, about=[0, 0, 0]),
        "sigma_mm of the motion is a list of 1",
    ),
    "views, text": (lambda t: cadcam.ViewRange(half_angle_deg="90"), "half_angle_deg of the views is the text '90'"),
    "distance, one": (lambda t: cadcam.ViewRange(distance_mm=900.0), "distance_mm of the views is 900.0"),
    "deviation, none": (lambda t: cadcam.Deviation("rib", 0.1, None), "expanded_uncertainty of 'rib' is None"),
    "aperture, text": (lambda t: cadcam.Aperture("2", 100.0), "diameter of the aperture is the text '2'"),
    "optics, no sensor": (lambda t: cadcam.Optics("1/2", 8.0, 900.0), "sensor is the text '1/2'.*sensor_format"),
    "look, text": (lambda t: cadcam.Look(head="bright"), "head is the text 'bright'"),
    "look, direction": (lambda t: cadcam.Look(fill_from=(0, 1)), r"fill_from is a tuple of 2; expected 3 numbers"),
    "lamp, name": (lambda t: cadcam.Lamp("north", 1.0), "towards is the text 'north'; expected 3 numbers"),
    "lamp, strength": (lambda t: cadcam.Lamp((0, 0, 1), "full"), "strength is the text 'full'; expected a number"),
    "light, one lamp": (lambda t: cadcam.Light(cadcam.Lamp((0, 0, 1), 1.0)), r"lamps is a Lamp.*\[lamps\]"),
    "lines, text": (lambda t: cadcam.LineOptions(near_mm="1"), "near_mm is the text '1'; expected a number"),
    "style, text": (lambda t: cadcam.LineStyle(width="thin"), "width is the text 'thin'"),
    "format, one": (lambda t: cadcam.SensorFormat("own", 8.8), "size_mm is 8.8; expected 2 numbers"),
    "format, pixels": (
        lambda t: cadcam.SensorFormat("own", (8, 6), (640.5, 480)),
        r"pixels\[0\] is 640.5.*whole number",
    ),
    "closeness, list": (lambda t: cadcam.ClosenessOptions(near=[3]), "near is a list of 1; expected a number"),
    "templates, count": (lambda t: cadcam.TemplateOptions(peaks=2.5), "peaks is 2.5; expected a whole number"),
    "pinhole, text": (lambda t: cadcam.ExtendedPinhole(*"abcdefghijk"), "X is the text 'a'; expected a number"),
    "inspection, none": (lambda t: cadcam.InspectionOptions(alarms=None), "alarms is None; expected a number"),
    "sensor, number": (lambda t: cadcam.Sensor(noise=3.0), "noise is 3.0; expected a Noise"),
    "method, array": (
        lambda t: cadcam.calibrate_camera(t.points, SIZE, method=np.array([])),
        r"method is an array of shape \(0,\); expected a str",
    ),
    "appearance, array": (
        lambda t: cadcam.TemplateOptions(appearance=np.array(["a", "b"])),
        r"appearance is an array of shape \(2,\); expected a str",
    ),
    "renderer, list": (
        lambda t: cadcam.open_renderer(t.scene, name=["ray"]),
        "renderer is a list of 1; expected a str",
    ),
    "loss, list": (lambda t: cadcam.Loss(["huber"]), "loss is a list of 1; expected a str"),
    "range, one": (lambda t: cadcam.ViewRange(distance_mm=[900]), "distance_mm is a list of 1; expected 2 numbers"),
    "record, time": (lambda t: cadcam.Record("part", time="2026-01-01"), "time of a record is the text.*fromisoformat"),
    "record, deviations": (lambda t: cadcam.Record("part", deviations=None), "deviations is None; expected a list"),
    "tolerances, names": (lambda t: cadcam.Tolerances(["rib"]), r"features\[0\] is the text 'rib'; expected a Feature"),
    "origin, time": (lambda t: cadcam.VerificationOrigin("part", time="now"), "time is the text 'now'"),
    "data set, matrices": (lambda t: cadcam.DatasetPlan(2, t.camera, poses=[np.eye(4)]), r"poses\[0\] is an array"),
    "data set, ground": (
        lambda t: cadcam.DatasetPlan(2, t.camera, backgrounds="plain"),
        "backgrounds is the text 'plain'",
    ),
    "data set, light": (lambda t: cadcam.DatasetPlan(2, t.camera, lights="hall"), "lights is the text 'hall'"),
    "aperture of a camera": (lambda t: cadcam.Aperture.of(t.camera), "optics is a Camera; expected an Optics"),
    "marks, radius": (
        lambda t: cadcam.find_marks(PICTURE, cadcam.parse_mark("dot:9mm"), radius_px="9 px"),
        "radius_px is .*9 px.*expected numbers",
    ),
    "marks, count": (
        lambda t: cadcam.find_marks(PICTURE, cadcam.parse_mark("dot:9mm"), count="2"),
        "count is the text",
    ),
    "data set, jitter": (lambda t: cadcam.DatasetPlan(2, t.camera, focal_jitter="1"), "focal_jitter is the text '1'"),
    "scale, none": (lambda t: t.mesh.scaled(None), "scale factor is None"),
    "move, matrix": (lambda t: t.mesh.transformed(np.eye(4)), "b_from_a is an array of shape.*from_matrix"),
    "crease, text": (lambda t: cadcam.feature_edges(t.mesh, crease_angle_deg="30"), "crease_angle_deg is the text"),
    "fixed, list": (
        lambda t: cadcam.calibrate_camera(t.points, SIZE, fixed=["skew"]),
        "fixed is a list of 1.*by name",
    ),
    "names, number": (lambda t: cadcam.measure_points([], np.zeros((0, 1, 2)), names=3), "names is 3"),
    "covariance, one": (
        lambda t: cadcam.Viewpoint.placed("a", t.estimate, t.pose, pose_covariance=0.1),
        r"pose covariance is of shape \(\); expected shape \(6, 6\)",
    ),
    "distortion, text": (lambda t: cadcam.Camera.from_opencv(SIZE, t.camera.K, "none"), "distortion coefficients is"),
    "verify, no photo": (lambda t: cadcam.verify_part(t.part, [], t.located, None), "photos is none"),
    "unit, number": (lambda t: cadcam.read_model("a.stl", unit=1000), "unit is 1000"),
    # numbers that are none, or beyond what they stand for
    "draws, nan": (
        lambda t: cadcam.monte_carlo_variability(t.estimate, rng=np.random.default_rng(1), draws=float("nan")),
        "number of draws is nan",
    ),
    "nodes, none": (lambda t: cadcam.projection_map(t.estimate, nodes=None), "nodes is None.*at least 2"),
    "threads, nan": (lambda t: cadcam.open_renderer(t.scene, threads=float("nan")), "threads is nan"),
    "workers, text": (
        lambda t: cadcam.make_dataset("never made", t.scene, cadcam.DatasetPlan(1, t.camera), workers="2"),
        "workers is the text '2'.*a whole number",
    ),
    "contacts, nan": (
        lambda t: cadcam.feature_edges(t.mesh, contact_tolerance_mm=float("nan")),
        "contact_tolerance_mm is nan",
    ),
    "contrast, nan": (lambda t: cadcam.CorrelateOptions(least_contrast=float("nan")), "least_contrast is nan"),
    "tilts, nan": (
        lambda t: cadcam.find_marks(PICTURE, cadcam.parse_mark("dot:30mm"), normal_sd=float("nan")),
        "normal_sd is nan",
    ),
    "edges, step nan": (lambda t: cadcam.edge_distances(PICTURE, t.wires, step_px=float("nan")), "step_px is nan"),
    "edges, within nan": (lambda t: cadcam.edge_distances(PICTURE, t.wires, within=float("nan")), "within is nan"),
    "odds, none": (lambda t: cadcam.order_marks(np.eye(2), np.eye(2), odds=None), "odds is None"),
    "pitch, nan": (lambda t: cadcam.write_cameras("never.yaml", t.camera, pixel_mm=float("nan")), "pixel_mm is nan"),
    # in place of what a function needs
    "lines, style": (lambda t: cadcam.overlay(PICTURE, t.wires, style="thin"), "style is the text 'thin'.*a LineStyle"),
    "line options": (
        lambda t: cadcam.visible_wireframe(t.scene, t.camera, t.pose, options="hidden"),
        "options is the text 'hidden'.*a LineOptions",
    ),
    "correlate, options": (
        lambda t: cadcam.correlate(PICTURE, cadcam.Template(PICTURE[:40, :40]), options=0.5),
        "options is 0.5; expected a CorrelateOptions",
    ),
    "cameras, path": (lambda t: cadcam.write_cameras("never.yaml", "camera.json"), "cameras is the text.*read_camera"),
    "viewer, pose": (lambda t: cadcam.viewer_parameters("pyvista", t.camera, None), "camera_from_world is None"),
    "viewer, near": (
        lambda t: cadcam.viewer_parameters("pyvista", t.camera, t.pose, near_mm=None),
        "near_mm is None; expected a number",
    ),
    "evidence, points": (
        lambda t: cadcam.refine_pose(t.part, [t.photo], t.pose, evidence=t.points),
        "evidence is an Observations; expected a list, each a PointEvidence",
    ),
    "marks, path": (lambda t: cadcam.measure_marks("station.json", []), "stations is the text.*a GantryCalibration"),
    "gantry, none": (lambda t: cadcam.calibrate_gantry("6", [None]), r"positions\[0\] is None.*a PlaneCalibration"),
    "place, survey": (
        lambda t: cadcam.calibrate_position("1", (0, 0), [[0, 0]], [[0, 0]]),
        "placement is a list of 1.*a Placement",
    ),
    "records, list": (
        lambda t: _added_as_a_list(cadcam.Record("part")),
        r"records\[0\] is a list of 1; expected a Record: one by one: store.add\(\*records\)",
    ),
    "record, pose": (lambda t: cadcam.Record("part", pose=t.pose), "pose of a record is a Rigid.*a PoseEstimate"),
}


@pytest.mark.parametrize("case", WRONG)
def test_a_wrong_argument_is_named_with_what_it_is_and_the_way_to_the_right_one(things: Things, case: str) -> None:
    call, words = WRONG[case]
    with pytest.raises(BadValue, match=words):
        call(things)


def test_a_value_is_told_by_its_kind_never_by_its_content() -> None:
    told = [said(v) for v in (None, 3, "a" * 99, np.zeros((4, 2)), [1, 2], {"a": 1}, cadcam.Camera, cadcam.Rigid())]
    assert told == [
        "None",
        "3",
        f"the text {'a' * 60!r}",
        "an array of shape (4, 2)",
        "a list of 2",
        "a dict of 1",
        "the class Camera",
        "a Rigid",
    ]


def test_names_are_several_texts() -> None:
    assert expect_names(["k1", "k2"], "free_lens") == ("k1", "k2")
    with pytest.raises(BadValue, match=r"free_lens is the text 'k1'; expected a list of names: \['k1'\]"):
        expect_names("k1", "free_lens")
    with pytest.raises(BadValue, match=r"free_lens\[1\] is 2; expected a str"):
        expect_names(["k1", 2], "free_lens")


def test_opencv_s_none_is_no_distortion(things: Things) -> None:
    assert cadcam.Camera.from_opencv(SIZE, things.camera.K, None).lens == cadcam.Ideal()


def test_the_right_kinds_pass() -> None:
    expect(1.0, "x", int, float)
    expect(None, "x", int, optional=True)
    assert expect_each(iter([1, 2]), "x", int) == (1, 2)
    with pytest.raises(BadValue, match=r"x\[1\] is None; expected an int"):
        expect_each([1, None], "x", int)
    with pytest.raises(BadValue, match=r"x is an array of shape \(\); expected a list"):
        expect_each(np.array("x"), "x", int)


def test_every_value_of_ours_is_told_in_two_lines_of_a_terminal(things: Things) -> None:
    calibrated = cadcam.Viewpoint.placed("one", things.estimate, things.pose, sigma_px=0.1)
    measured = cadcam.predict_points([calibrated, calibrated], np.zeros((40, 3)))
    values = [*things, things.located.pose, things.located.matches, things.scene.edges, things.wires.visible]
    values += [calibrated, measured, cadcam.KnownMotion(things.pose), cadcam.Frame.of(0, things.photo)]
    values += [cadcam.predict_points([calibrated, calibrated], np.zeros((1, 3)))]  # a mapping of small arrays
    values += [cadcam.find_board(PICTURE, things.pattern), things.estimate.extended_pinhole, cadcam.ViewRange.above()]
    for value in values:
        assert len(repr(value)) < 400
        assert "array(" not in repr(value)


def test_no_public_value_that_holds_arrays_is_told_by_all_their_numbers() -> None:
    for name in cadcam.__all__:
        kind = getattr(cadcam, name)
        arrays = is_dataclass(kind) and any(re.search(r"Array\b|\bPicture\b", str(f.type)) for f in fields(kind))
        assert not (arrays and hasattr(kind.__repr__, "__wrapped__")), f"{name}: give it a repr, or make it Brief"


def test_no_public_thing_is_told_by_its_address(things: Things, tmp_path: Path) -> None:
    renderers = [cadcam.open_renderer(things.scene, name) for name in ("raster", "ray")]
    cadcam.write_picture(tmp_path / "1.png", PICTURE)
    values = [*renderers, cadcam.Photographer(things.scene, renderer="ray"), cadcam.Template(PICTURE)]
    with cadcam.open_store(tmp_path / "store.db") as store:
        values += [store, cadcam.Frames([tmp_path], [things.photo.viewpoint])]
        for value in values:
            assert repr(value).startswith(f"{type(value).__name__}(")
            assert " at 0x" not in repr(value)
            assert len(repr(value)) < 400
    for name in cadcam.__all__:
        kind = getattr(cadcam, name)
        assert not isinstance(kind, type) or kind.__repr__ is not object.__repr__, f"{name}: give it a repr"


def test_a_pose_is_told_with_its_sigmas_and_a_lens_by_the_terms_it_has(things: Things) -> None:
    pose = cadcam.PoseEstimate(cadcam.Rigid(), np.diag([0.01, 0.04, 0.09, *np.radians([1, 2, 3]) ** 2]))
    assert repr(pose).endswith("sigma [0.1 0.2 0.3] mm, [1. 2. 3.] deg)")
    assert repr(cadcam.BrownConrady(k1=-0.25, p2=np.float32(0.5))) == "BrownConrady(k1=-0.25, p2=0.5)"
    assert "aspect=1, focal=331.4" in repr(things.estimate.extended_pinhole)
    assert "a=" in repr(things.estimate.extended_pinhole)
    assert " rad, " in repr(things.estimate.extended_pinhole)
