"""What a tolerance file says, and what is said of a wrong one."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from cadcam.cad.edges import EdgeKind
from cadcam.cad.parts.shape import box
from cadcam.errors import BadValue, CadcamError, UnknownName
from cadcam.geometry.rigid import Rigid
from cadcam.locate.location import Location
from cadcam.locate.photo import Photo
from cadcam.render.view import Scene
from cadcam.verify.judge import verify_part
from cadcam.verify.tolerances.file import read_tolerances, template
from cadcam.verify.tolerances.tolerance import Feature, Limit, Quantity, Rule, Selection, Tolerances, runs, whole_parts

from .scene import CAMERA, part

GOOD = """\
k: 2.5
datum: [{part: plate}]
features:
  rib:
    part: rib 1
    position_mm: 0.5
    angle_deg: 0.3
    presence: required
  corner of the block:
    part: block
    box_mm: [[100, -80, 10], [130, 0, 50]]
    kinds: [crease, contact]
    direction: [0, 3, 4]
    position_mm: 1
    profile_mm: 2
    k: 3
    rule: simple acceptance
"""


def written(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "tolerances.yaml"
    path.write_text(text)
    return path


def test_a_file_says_what_it_says(tmp_path: Path) -> None:
    found = read_tolerances(written(tmp_path, GOOD))
    rib, corner = found.features
    assert [limit.quantity for limit in rib.limits] == [Quantity.POSITION, Quantity.ANGLE, Quantity.PRESENCE]
    assert rib.limits[0].k == 2.5
    assert rib.limits[0].rule is Rule.GUARD_BAND
    assert rib.limits[1].value == pytest.approx(np.radians(0.3))
    assert corner.limits[0].rule is Rule.SIMPLE
    assert corner.limits[0].k == 3
    np.testing.assert_allclose(corner.limits[0].direction, [0, 0.6, 0.8])
    assert corner.limits[1].direction is None  # a direction is of a position
    assert corner.selection.kinds == (EdgeKind.CREASE, EdgeKind.CONTACT)
    found.check(part().scene)
    across = read_tolerances(written(tmp_path, GOOD.replace("direction:", "axis:"))).features[1].limits
    np.testing.assert_allclose(across[0].axis, [0, 0.6, 0.8])
    assert across[1].axis is None


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("part: rib 1", "part: rib 7", r"unknown part 'rib 7'; did you mean 'rib \d'\? \(known: block, bracket"),
        ("[[100, -80, 10]", "[[900, -80, 10]", r"a list|lowest corner"),
        ("kinds: [crease, contact]", "kinds: [creese]", r"unknown kind of edge 'creese'; did you mean 'crease'"),
        ("kinds: [crease, contact]", "chains: [1]", r"chain of 'block' is 1; expected one of \d+"),
        ("position_mm: 0.5", "positon_mm: 0.5", r"unknown key 'positon_mm'; did you mean 'position_mm'"),
        ("position_mm: 0.5", "position_mm: -0.5", r"position_mm is -0.5; expected a positive number"),
        ("rule: simple acceptance", "rule: simple", r"unknown decision rule 'simple'"),
        ("presence: required", "presence: perhaps", r"write presence: required"),
        ("    direction: [0, 3, 4]\n", "    direction: [0, 0, 0]\n", r"a vector that is not zero"),
        ("datum: [{part: plate}]", "datum: [{}]", r"does not say which edges"),
        ("datum: [{part: plate}]", "datum: plate", r"datum is not a list; write '- part: name' lines"),
        ("datum: [{part: plate}]", "datum: [plate]", r"datum.0 is \"plate\"; write '- part: name' lines"),
        ("datum: [{part: plate}]", "datum: []", r"datum names nothing; .* or leave it out"),
        ("datum: [{part: plate}]", "datum: [{part: plte}]", r"datum 0: unknown part 'plte'; did you mean 'plate'"),
        ("datum: [{part: plate}]", "datum: [{part: rib 1}]", r"datum is all within feature 'rib'"),
        ("part: rib 1", "part: '*'", r"datum is all within feature 'rib'"),
        ("part: rib 1", "part: rib 7", r"feature 'rib': unknown part"),
        ("part: rib 1", "part: rib 1\n    chains: []", r"features.rib.chains is empty; name what is meant"),
        ("part: rib 1", "part: rib 1\n    chains: [12.5]", r"features.rib.chains.0 is 12.5; a whole number"),
        ("kinds: [crease, contact]", "kinds: []", r"kinds is empty; name what is meant"),
        ("kinds: [crease, contact]", "kinds: crease", r"kinds is not a list; a list of texts is expected"),
        ("position_mm: 0.5\n", "direction: [0, 1, 0]\n", r"features.rib has a direction; it is that of a position_mm"),
        ("position_mm: 0.5\n", "axis: [0, 1, 0]\n", r"features.rib has an axis; it is that of a position_mm"),
        ("[0, 3, 4]\n", "[0, 3, 4]\n    axis: [1, 0, 0]\n", r"direction is given beside an axis; expected one of them"),
        ("position_mm: 0.5", "position_mm: .nan", r"features.rib.position_mm is not finite"),
        ("position_mm: 0.5", "position_mm: 0.5 mm", r'features.rib.position_mm is "0.5 mm"; a number is expected'),
        ("position_mm: 0.5\n", "position_mm: [-0.5, 0.2]\n", r"is \[-0.5, 0.2\]; a number is expected, or a direction"),
        ("position_mm: 0.5", "position_um: 500", r"unknown key 'position_um'; did you mean 'position_mm'"),
        ("angle_deg: 0.3", "angle_deg: 180", r"angle_deg is 180.0; expected less than 180"),
        ("presence: required", "presence: 1", r"features.rib.presence is 1.0; write presence: required"),
        ("presence: required", "presence: false", r"features.rib.presence is false; write presence: required"),
        ("k: 2.5", "k: 0", r"k is 0; a coverage factor up to 10 is expected"),
        ("k: 3", "k: 95", r"corner of the block.k is 95; a coverage factor up to 10 is expected"),
        ("k: 2.5", "k: .nan", r"k is not finite"),
        ("  rib:", '  " ":', r'features names a feature " "; a name that can be read'),
        ("  rib:", '  "r\\u001bb":', r'features names a feature "r\\u001bb"; a name that can be read'),
        ("  rib:", "  corner of the block:", r"line 9 has the key 'corner of the block' twice"),
        ("    part: rib 1\n", "    part:rib 1\n", r"is not YAML"),
    ],
)
def test_what_is_wrong_is_named_with_what_there_is(tmp_path: Path, old: str, new: str, said: str) -> None:
    assert old in GOOD
    with pytest.raises(CadcamError, match=said):
        read_tolerances(written(tmp_path, GOOD.replace(old, new))).check(part().scene)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", r"is empty"),
        ("# to be written\n", r"holds no YAML document"),
        ("features:\n", r"features names no feature; write name: \{part: ..., position_mm: ...\}"),
        ("features:\n  - part: rib 1\n", r"features names no feature; write name"),
        ("features:\n  rib:\n", r"features.rib is null; write name"),
        (
            "features:\n  rib:\n    part:rib 1\n    position_mm:1\n",
            r'features.rib is "part:rib 1 position_mm:1"; write',
        ),
        ('[features.rib]\npart = "rib 1"\n', r"is not YAML|'key: value' lines are expected"),
        ('k = 2\npart = "rib 1"\n', r"'key: value' lines are expected"),
        ('{"features": {"rib": {"part": "rib 1", "position_mm": 0.5}', r"is not YAML: .* is it cut off\?"),
        ("features: {every: {part: '*', position_mm: 1}}\n", r"datum is all within feature 'every'; expected parts"),
    ],
)
def test_a_file_of_another_kind_or_without_a_datum_says_what_to_write(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(CadcamError, match=said):
        read_tolerances(written(tmp_path, text)).check(part().scene)


def test_json_is_yaml_and_every_feature_may_be_measured_from_the_others(tmp_path: Path) -> None:
    text = '{"datum": [{"part": "*"}], "features": {"rib": {"part": "rib 1", "position_mm": 0.5}}}'
    read_tolerances(written(tmp_path, text)).check(part().scene)
    read_tolerances(written(tmp_path, text.replace("rib 1", "rib*"))).check(part().scene)


def test_a_box_beside_the_part_says_where_its_edges_are() -> None:
    with pytest.raises(BadValue, match=r"'block' is empty; expected a box_mm within \[70.* to \[120.0, -10.0, 45.0\]"):
        Selection("block", box=np.array([[0, 0, 0], [1, 1, 1.0]])).check(part().scene)


def test_names_are_checked_before_the_edges_that_they_have(tmp_path: Path) -> None:
    """Whatever stands first in the file: a box that holds nothing is known only once edges are found."""
    box = "box_mm: [[0, 0, 0], [1, 1, 1]]"
    text = f"features: {{a: {{part: block, {box}, position_mm: 1}}, b: {{part: blok, position_mm: 1}}}}"
    found = read_tolerances(written(tmp_path, text))
    for check in (lambda: found.check(part().scene), lambda: found.check_names(part().scene.mesh.part_names)):
        with pytest.raises(UnknownName, match="feature 'b': unknown part 'blok'; did you mean 'block'"):
            check()


def test_the_template_is_a_valid_file(tmp_path: Path) -> None:
    found = read_tolerances(written(tmp_path, template(part().scene, seen=("plate", "rib 2"))))
    found.check(part().scene)
    assert [d.part for d in found.datum] == ["plate", "rib 2"]


def test_a_template_is_of_parts_and_edges_that_there_are() -> None:
    with pytest.raises(UnknownName, match="unknown part 'plat'; did you mean 'plate'"):
        template(part().scene, seen=("rib 2", "plat"))
    with pytest.raises(BadValue, match=r"^seen is the text 'plate'; expected a list of names: \['plate'\]$"):
        template(part().scene, seen="plate")
    with pytest.raises(BadValue, match=r"^chain of 'plate' is 99999; expected one of "):
        template(part().scene, seen=["plate"], chain=99999)


def test_a_name_full_of_signs_means_only_itself() -> None:
    selection = whole_parts(part().scene).features[1].selection
    assert selection.bodies(part().scene).tolist() == [False, True, False, False, False]
    with pytest.raises(UnknownName):
        Selection("rib [34]").bodies(part().scene)
    assert Selection("rib [12]").bodies(part().scene).sum() == 2
    assert Selection("rib [2]").among(["rib [2]", "rib 2"]).tolist() == [True, False]


@pytest.mark.parametrize("name", ["rib ", " rib", "rib\t2", "rib\n2\\", "rib\x85\U0001f600", "'rib'", "no", "1: a"])
def test_a_template_names_parts_whatever_their_names(tmp_path: Path, name: str) -> None:
    scene = Scene.of(box((0, 0, 0), (10, 10, 10), name=name))
    assert read_tolerances(written(tmp_path, template(scene))).datum[0].part == scene.mesh.part_names[0] == name


def test_runs_are_shortened() -> None:
    assert runs([1, 2, 3, 7, 9, 10]) == "1 to 3, 7, 9, 10"


@pytest.mark.parametrize(
    ("made", "said"),
    [
        (lambda: Selection(5), r"part of a selection is 5; expected a str"),
        (lambda: Selection("*", chains=12), r"chains is of shape \(\); expected shape \(N\)"),
        (lambda: Selection("*", chains="12"), r"chains is of shape \(\)|chains is '12'"),
        (lambda: Selection("*", chains=[1.5]), r"chains\[0\] is 1.5; expected a whole number"),
        (lambda: Selection("*", kinds=EdgeKind.BREP), r"kinds is .*; expected a list of them: \[kinds\]"),
        (lambda: Selection("*", kinds=("brep",)), r"kinds\[0\] is the text 'brep'; expected an EdgeKind"),
        (lambda: Feature("rib", "rib 1"), r"selection of feature 'rib' is the text 'rib 1'; expected a Selection"),
        (lambda: Feature(3, Selection("*")), r"name of a feature is 3; expected a str"),
        (
            lambda: Feature("rib", Selection("*"), Limit(Quantity.PROFILE, 1.0)),
            r"limits of feature 'rib' is a Limit; expected a list of them",
        ),
    ],
)
def test_what_is_no_selection_or_limit_is_refused_where_it_is_made(made: Callable[[], object], said: str) -> None:
    with pytest.raises(BadValue, match=said):
        made()


def test_chains_may_be_any_list_of_numbers() -> None:
    for chains in ([0, 1], np.array([0, 1]), (0, 1)):
        selection = Selection("plate", chains=chains)  # type: ignore[arg-type]
        assert selection.chains == (0, 1)
        selection.check(part().scene)
    assert Selection("plate", chains=[]).whole  # type: ignore[arg-type]


def test_options_and_freedom_of_another_kind_are_refused_at_once() -> None:
    nowhere = Location.nowhere(Rigid(), "not looked for")
    photos = [Photo.of(np.zeros((360, 480), np.float32), CAMERA)]
    with pytest.raises(BadValue, match=r"options is 3; expected an InspectionOptions"):
        verify_part(part(), photos, nowhere, Tolerances(), options=3)  # type: ignore[arg-type]
    with pytest.raises(BadValue, match=r"freedom is an array of shape \(6, 6\); expected a Freedom"):
        verify_part(part(), photos, nowhere, Tolerances(), freedom=np.eye(6))  # type: ignore[arg-type]
