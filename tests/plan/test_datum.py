"""Features that are judged from a datum in the same pictures: a layout says of them what `verify` will state."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cadcam.arrays import Array
from cadcam.cad.edges import EdgeKind
from cadcam.cad.mesh import Mesh
from cadcam.cad.parts.shape import box
from cadcam.cad.write import write_model
from cadcam.camera.error_source import ErrorSource
from cadcam.camera.viewpoint import Viewpoint
from cadcam.errors import BadValue, UnknownName, UnreadableFile
from cadcam.plan.layout import CandidateSurvey, plan_layout, survey
from cadcam.plan.scene.feature import LayoutFeature
from cadcam.plan.scene.file import read_layout_scene
from cadcam.plan.scene.layout_scene import LayoutScene, Sigmas
from cadcam.plan.sight.candidate import Candidate
from cadcam.plan.sight.datum import USUAL_PX, DatumEvidence, together_from_datum
from cadcam.plan.uncertainty.finding import Finder
from cadcam.plan.what_if import what_if
from cadcam.render.view import Scene
from cadcam.report.layout.words import assumptions
from cadcam.verify.adjustment.datum_fit import Adjustment
from cadcam.verify.adjustment.scatter import EdgeNoise
from cadcam.verify.deviations.measured import UNSEEN_PX
from cadcam.verify.edges.association import searchable
from cadcam.verify.edges.sightlines import STEP_PX, lines_in_view
from cadcam.verify.edges.step_fit import ROOM_PX
from cadcam.verify.tolerances.tolerance import Selection

from .scenes import part, position, ring, scene

AXES = tuple(position(0.3, axis)[0] for axis in np.eye(3))
POST = LayoutFeature.selected("post", Selection("post"), Scene.of(part()), AXES)


def judged(datum: tuple[str, ...] = ("floor", "wall"), n: int = 6, **changes: Any) -> LayoutScene:
    """Return the box with its post judged from other bodies, by n cameras."""
    chosen = tuple(Selection(name) for name in datum)
    made = scene(n, features=(POST,), finder=Finder(gray=0.01, contrast=0.3), datum=chosen)
    return replace(made, **changes)


def sigma(made: LayoutScene, chosen: tuple[int, ...] = (0, 2, 4)) -> Array:
    """Return the sigma (3,) mm of the post along x, y, z in the first pose."""
    return np.asarray(survey(made).assess(chosen).sigma[0])


def adjusted(seen: CandidateSurvey, chosen: list[Candidate], pose: Any) -> Array:
    """Return the covariance (3, 3) that verify's own adjustment states of all cameras' lines at once."""
    assert seen.judging is not None
    drawn = seen.judging.part
    views = [c.viewpoint for c in chosen]
    lines, _ = lines_in_view(drawn, views, pose)
    z = np.array([(views[i].camera_from_world @ pose @ p)[2] for i, p in zip(lines.photo, lines.p, strict=True)])
    finder = seen.scene.finder
    blur = finder.blur(chosen[0].optics, z)
    use = searchable(lines, [v.camera for v in views]) & (lines.room >= ROOM_PX + 1.5 * blur) & (lines.chain >= 0)
    lines, blur = lines.select(use), blur[use]
    errors = EdgeNoise.of(1 / np.sqrt(finder.per_px(blur) * STEP_PX), lines.edge, lines.along, USUAL_PX)
    names = np.array(drawn.scene.mesh.part_names)[lines.part]
    fit = Adjustment(
        np.zeros(len(lines)),
        lines.by_pose,
        lines.by_cause,
        errors,
        np.isin(names, [s.part for s in seen.judging.datum]),
    )
    rows = names == "post"
    central = [o.mm_per_px[0, 0] for o, c in zip(seen.visibility, seen.candidates, strict=True) if c in chosen]
    prior = UNSEEN_PX * float(np.mean(central))
    return fit.estimate(rows, lines.by_point[rows], fit.pose(without=rows), prior=prior).covariance


@pytest.mark.parametrize("shared", [False, True], ids=["cameras of their own", "one camera that is moved"])
def test_a_layout_states_what_verifys_adjustment_states(shared: bool) -> None:
    made = judged(mounts=(replace(ring(6), one_camera=shared),))
    seen, chosen = survey(made), (0, 2, 4)
    expected = adjusted(seen, [seen.candidates[i] for i in chosen], seen.poses[0])
    np.testing.assert_allclose(seen.assess(chosen).sigma[0], np.sqrt(np.diag(expected)), rtol=1e-6)


def test_errors_common_to_feature_and_datum_cancel() -> None:
    """Cameras that are off all alike displace the datum by as much as the feature: nothing is left of 10 mm."""
    seen = survey(judged())
    rig, effect = ErrorSource("rig", 100.0 * np.eye(3), object()), np.eye(11, 3)
    evidence = [_of(seen, replace(c.viewpoint, errors=((rig, effect),)), c) for c in seen.candidates[:3]]
    told = together_from_datum(evidence, [np.arange(3)] * 3, 3, np.eye(3)[None] / 9)
    by_itself = [replace(e, fitted=np.concatenate([e.fitted[..., :6], 0 * e.fitted[..., 6:]], -1)) for e in evidence]
    alone = together_from_datum(by_itself, [np.arange(3)] * 3, 3, np.eye(3)[None] / 9)
    assert np.abs(alone.by_number[0]).max() > 9
    np.testing.assert_allclose(told.by_number[0], 0, atol=1e-9 * np.abs(alone.by_number[0]).max())


def _of(seen: CandidateSurvey, view: Viewpoint, camera: Candidate) -> DatumEvidence:
    made = seen.scene
    assert seen.judging is not None
    return seen.judging.seen_from(
        view, camera.optics, seen.poses[:1], seen.surroundings, finder=made.finder, seeing=made.seeing
    )


def test_errors_of_single_cameras_matter_less_than_to_a_place() -> None:
    off = judged(calibration=Sigmas(position_mm=2.0))
    assert (sigma(replace(off, datum=())) > 3 * sigma(off)).all()


def test_blurred_pictures_tell_less_than_sharp_ones() -> None:
    """Information falls as the blur grows: by itself, with edges that err by nothing else to speak of."""
    noise = {"gray": 0.05, "contrast": 0.3, "floor_px": 1e-6}
    sharp, blurred = (survey(judged(finder=Finder(**noise, blur_px=b), calibration=Sigmas())) for b in (0.6, 0.9))
    told = [o for o in (seen.visibility[0].datum for seen in (sharp, blurred)) if o is not None]
    own = [o.own[0, 0, :, :3] / o.length_px[0, 0] for o in told]
    assert np.trace(own[0]) > 1.2 * np.trace(own[1])


def test_a_datum_of_few_edges_makes_U_larger() -> None:
    exact = Sigmas()
    many, few = (sigma(judged(names, calibration=exact)) for names in (("floor", "wall"), ("wall",)))
    assert (few > many).all()


def test_a_datum_known_exactly_leaves_the_features_own_error() -> None:
    """With far more information on the pose, and no error of cameras, only the feature's own edges are left."""
    seen = survey(judged(calibration=Sigmas()))
    own = seen.assess((0, 2, 4)).sigma[0]
    sure = [
        replace(o, datum=replace(o.datum, fitted=1e9 * o.datum.fitted)) for o in seen.visibility if o.datum is not None
    ]
    exact = replace(seen, visibility=tuple(sure)).assess((0, 2, 4))
    N = sum(o.datum.own[0, 0, :, :3] for i, o in enumerate(sure) if i in (0, 2, 4) and o.datum is not None)
    size = float(np.mean([seen.visibility[i].mm_per_px[0, 0] for i in (0, 2, 4)]))
    alone = np.linalg.inv(N + np.eye(3) / (UNSEEN_PX * size) ** 2)
    np.testing.assert_allclose(exact.sigma[0], np.sqrt(np.diag(alone)), rtol=1e-6)
    assert (own > exact.sigma[0]).all()


def test_an_edge_that_is_hidden_in_part_tells_by_its_visible_length() -> None:
    """A plate before one end of the post's and the floor's edges takes their places away, not the cameras."""
    free, hidden = (survey(judged(calibration=Sigmas(), obstacles=obstacles)) for obstacles in (None, screen()))
    length = [[o.datum.length_px[0, 0] for o in seen.visibility if o.datum is not None] for seen in (free, hidden)]
    assert (np.array(length[1]) <= length[0]).all()
    less = np.array(length[1]) < length[0]
    assert less.any()
    assert (np.array(length[1]) > 0).all()
    assert all(o.seen[0, 0] for o in hidden.visibility)
    assert (hidden.assess((0, 2, 4)).sigma[0] > free.assess((0, 2, 4)).sigma[0]).all()


def screen() -> Mesh:
    return box((280, 60, 95), (350, 116, 97), name="screen", color=(0.5, 0.5, 0.5))


@pytest.mark.parametrize("common_px", [0.005, *(pytest.param(px, marks=pytest.mark.slow) for px in (0.01, 0.02)), 0.05])
def test_a_search_finds_what_is_nearly_the_best_set(common_px: float) -> None:
    """The search treats the pose's error as each camera's own; of all sets its choice is worst by a tenth at most."""
    seen = survey(judged(n=8, finder=Finder(gray=0.01, contrast=0.3, floor_px=common_px)))
    best = max(seen.score(chosen).worst for chosen in combinations(range(8), 3))
    assert plan_layout(seen, 3).assessment.worst >= 0.9 * best


def test_what_if_and_the_report_know_the_datum() -> None:
    layout = plan_layout(judged(calibration=Sigmas()), 3)
    table = {w.change: w.worst for w in what_if(layout)}
    assert table["twice the noise"] < table["as planned"] < table["half the noise"]
    assert any("relative to floor, wall" in said for said in assumptions(layout))
    assert layout.all_of_them.worst >= layout.assessment.worst


FILE = """\
part: {model: part.obj, unit: mm}
cameras: {cam: {sensor: IMX264, focal_mm: 16, f_number: 8}}
mounts: {post: {positions_mm: [[900, 0, 700], [-600, 0, 700]]}}
features:
  post: {part: post, position_mm: 1}
  mark: {point_mm: [60, 80, 10], normal: [0, 0, 1], position_mm: 1}
datum: [{part: floor, kinds: [crease]}, {part: wa*}]
noise: {sigma_px: 0.1, gray: 0.01, contrast: 0.3}
"""


def read(folder: Path, text: str = FILE) -> LayoutScene:
    write_model(folder / "part.obj", part())
    (folder / "scene.yaml").write_text(text)
    return read_layout_scene(folder / "scene.yaml")


def test_a_datum_is_read_as_in_a_tolerance_file(tmp_path: Path) -> None:
    made = read(tmp_path)
    assert [s.part for s in made.datum] == ["floor", "wa*"]
    assert made.judged == (0,)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("part: floor,", "part: flor,", "datum.*'flor'.*floor"),
        ("[{part: floor, kinds: [crease]}, {part: wa*}]", "[]", "datum.*names nothing"),
        ("kinds: [crease]", "kind: [crease]", "datum.*kind.*kinds"),
        (", gray: 0.01, contrast: 0.3", "", "gray and contrast"),
        ("  post: {part: post, position_mm: 1}\n", "", "no feature is judged from it"),
        ("position_mm: 1}\n  mark", "angle_deg: 1}\n  mark", "angle_deg of post"),
    ],
)
def test_a_datum_that_is_wrong_is_refused(tmp_path: Path, old: str, new: str, said: str) -> None:
    assert old in FILE
    with pytest.raises(UnreadableFile, match=f"(?s){said}"):
        read(tmp_path, FILE.replace(old, new))


def test_a_datum_that_does_not_hold_the_part_is_refused() -> None:
    one = Selection("wall", box=np.array([[179.0, 39, 119], [181, 301, 121]]), kinds=(EdgeKind.BREP,))
    with pytest.raises(BadValue, match="hold the part"):
        survey(replace(judged(), datum=(one,)))


def test_names_that_the_part_does_not_have_are_refused() -> None:
    with pytest.raises(UnknownName, match="flor"):
        judged(("flor",))
