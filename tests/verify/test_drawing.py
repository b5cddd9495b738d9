"""A STEP file's own tolerances become a tolerance file: each a limit of the right edges, or a comment with why."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest
import yaml

from cadcam.cad.pmi.read import read_pmi
from cadcam.cad.read import read_model
from cadcam.cli.main import main
from cadcam.errors import UnknownName
from cadcam.render.view import Scene
from cadcam.verify.tolerances.drawing import drawing_template
from cadcam.verify.tolerances.file import read_tolerances
from cadcam.verify.tolerances.tolerance import Quantity, Selection, Tolerances

from ..cad.drawn_plate import DrawnPlate

pytest.importorskip("cascadio", reason='reading STEP needs the extra "step"')

PLATE = Path(__file__).resolve().parents[2] / "models/drilled_plate.step"
_EPS = np.finfo(np.float64).eps


@lru_cache
def scene(path: Path) -> Scene:
    return Scene.of(read_model(path))


def as_written(path: Path, folder: Path, **options: object) -> tuple[Tolerances, str]:
    text = drawing_template(scene(path), read_pmi(path), path.name, **options)
    (folder / "tolerances.yaml").write_text(text)
    return read_tolerances(folder / "tolerances.yaml"), text


def middle(selection: Selection, of: Scene) -> np.ndarray:
    """Return the middle (3,) of the box of the selected edges."""
    p = of.mesh.vertices[of.edges.vertices[np.isin(of.edges.chain, selection.chains)]].reshape(-1, 3)
    return (p.min(axis=0) + p.max(axis=0)) / 2


def test_holes_are_judged_across_their_axes_and_by_their_diameters(tmp_path: Path) -> None:
    found, _ = as_written(PLATE, tmp_path)
    found.check(scene(PLATE))
    asked = {f.name: f for f in found.features}
    assert set(asked) == {"hole 20 mm no 1", "hole 20 mm no 2", "hole 12 mm", "hole 8 mm", "front", "back"}
    position, diameter = asked["hole 12 mm"].limits
    assert (position.quantity, position.value) == (Quantity.POSITION, 0.15)
    np.testing.assert_allclose(position.axis, [0, 0, 1], atol=_EPS)
    assert diameter.quantity is Quantity.DIAMETER
    assert (diameter.value, diameter.middle) == pytest.approx((0.1, 0.1))  # 12 to 12.2 mm, of a hole drawn as 12
    (fit,) = asked["hole 8 mm"].limits
    assert (fit.value, fit.middle) == pytest.approx((0.045, 0.045))  # H11
    for name, place in (("hole 12 mm", (60, 60)), ("hole 20 mm no 1", (45, 25)), ("hole 20 mm no 2", (75, 25))):
        np.testing.assert_allclose(middle(asked[name].selection, scene(PLATE)), [*place, 5], atol=1e-3)


def test_a_hole_s_position_within_a_width_is_no_cylinder(tmp_path: Path) -> None:
    """It was judged in all directions across the axis: holes FAILed along that which the drawing leaves free."""
    pmi = read_pmi(PLATE)
    wide = replace(pmi, tolerances=tuple(replace(t, diametral=False) for t in pmi.tolerances))
    text = drawing_template(scene(PLATE), wide, PLATE.name)
    (tmp_path / "tolerances.yaml").write_text(text)
    asked = {f.name: f for f in read_tolerances(tmp_path / "tolerances.yaml").features}
    assert Quantity.POSITION not in {limit.quantity for limit in asked["hole 12 mm"].limits}
    assert "its zone is a width, no cylinder" in text


def test_a_plane_face_is_judged_along_its_normal(tmp_path: Path) -> None:
    found, _ = as_written(PLATE, tmp_path)
    front = next(f for f in found.features if f.name == "front")
    (limit,) = front.limits
    assert (limit.quantity, limit.value) == (Quantity.POSITION, 0.25)
    np.testing.assert_allclose(limit.direction, [0, -1, 0], atol=_EPS)
    np.testing.assert_allclose(middle(front.selection, scene(PLATE)), [60, 0, 5], atol=1e-3)


def test_a_zone_that_lies_outside_its_face_has_both_its_limits(tmp_path: Path) -> None:
    found, text = as_written(PLATE, tmp_path)
    (limit,) = next(f for f in found.features if f.name == "back").limits
    np.testing.assert_allclose(limit.direction, [0, 1, 0], atol=_EPS)
    assert limit.bounds == (0.0, 0.5)
    assert "# back: surface profile 0.5 mm to A B C, 0.5 mm of it outside\n" in text


def test_a_distance_is_between_the_features_that_are_judged_otherwise(tmp_path: Path) -> None:
    found, text = as_written(PLATE, tmp_path)
    (distance,) = found.distances
    assert (distance.name, distance.between) == ("distance 30 mm", ("hole 20 mm no 1", "hole 20 mm no 2"))
    assert distance.limit.bounds == pytest.approx((-0.2, 0.2))
    assert distance.limit.direction is None
    assert found.spacing(distance, scene(PLATE)).mm == pytest.approx(30.0, abs=1e-4)
    assert "# 29.8 to 30.2 mm\n" in text


def test_distances_between_faces_and_along_an_axis_have_their_direction(tmp_path: Path) -> None:
    """To the left side from a hole, from side to side, of two holes along y; and one that the CAD does not have."""
    plate = DrawnPlate()
    sides, holes = plate.sides, plate.halves
    plate.distance(45.0, 44.9, 45.1, holes["left"][0], sides["left"])
    plate.distance(120.0, 119.5, 120.0, sides["left"], sides["right"])
    plate.distance(35.0, 34.9, 35.2, holes["left"][0], holes["small"][1])
    plate.distance(36.0, 35.9, 36.2, holes["left"][0], holes["small"][1])
    plate.distance(10.0, 9.9, 10.1, holes["left"][0], sides["top"])  # it is along the hole's axis
    (tmp_path / "plate.step").write_text(plate.whole())
    found, text = as_written(tmp_path / "plate.step", tmp_path)
    found.check(scene(tmp_path / "plate.step"))
    assert [f.name for f in found.features] == ["hole 20 mm", "face no 1", "face no 2", "hole 12 mm"]
    assert not any(f.limits for f in found.features)
    to_side, across, along_y = found.distances
    assert to_side.between == ("hole 20 mm", "face no 1")
    assert across.limit.bounds == pytest.approx((-0.5, 0.0))
    for distance, way, mm in ((to_side, [1, 0, 0], 45), (across, [1, 0, 0], 120), (along_y, [0, 1, 0], 35)):
        spacing = found.spacing(distance, scene(tmp_path / "plate.step"))
        np.testing.assert_allclose(np.abs(spacing.way), way, atol=_EPS)
        assert spacing.mm == pytest.approx(mm, abs=1e-4)
    for said in ("36 mm (35.9 to 36.2)", "10 mm (9.9 to 10.1)"):
        assert f"#   linear distance {said}: it is not between holes, pins or parallel faces" in text


def test_the_datum_is_the_way_round_its_plane_and_the_rims_of_its_holes(tmp_path: Path) -> None:
    found, _ = as_written(PLATE, tmp_path)
    places = [middle(selection, scene(PLATE)) for selection in found.datum]
    np.testing.assert_allclose(places, [[60, 40, 10], [15, 40, 5], [105, 40, 5]], atol=1e-3)
    assert [len(selection.chains) for selection in found.datum] == [4, 4, 4]


def test_what_is_not_judged_is_told_with_why(tmp_path: Path) -> None:
    _, text = as_written(PLATE, tmp_path)
    comments = text.partition("# Stated, but not judged here:\n")[2].splitlines()
    assert [line.rpartition(": ")[0].lstrip("# ") for line in comments[:-1]] == [
        "flat: flatness 0.1 mm",
        "upright: perpendicularity 0.2 mm diameter to A",
    ]
    assert all(len(line.rpartition(": ")[2]) > 20 for line in comments[:-1])
    assert comments[-1] == "#   angle"


def test_features_out_of_view_are_left_to_a_comment(tmp_path: Path) -> None:
    every, _ = as_written(PLATE, tmp_path)
    hole = next(f for f in every.features if f.name == "hole 12 mm")
    found, text = as_written(PLATE, tmp_path, seen=hole.selection.chains[:1])
    assert [f.name for f in found.features] == ["hole 12 mm"]
    assert "#   hole 20 mm no 2: not in view\n" in text


def test_another_system_of_datums_is_written_when_it_is_asked_for(tmp_path: Path) -> None:
    _, text = as_written(PLATE, tmp_path, letters=["A"])
    assert "  # A: the pose is fitted" in text
    assert "pair: position 0.4 mm diameter to A B C: stated to other datums: a file of its own, --datum 'A B C'" in text
    with pytest.raises(UnknownName, match=r"unknown datum system 'A C'; .*known: A, A B C"):
        as_written(PLATE, tmp_path, letters=["A", "C"])


@pytest.mark.parametrize("number", [1, 3, 5, *(pytest.param(number, marks=pytest.mark.slow) for number in (2, 4))])
def test_of_nist_s_test_cases_nothing_is_dropped_unsaid(
    tmp_path: Path, shared: Callable[[str], Path], number: int
) -> None:
    """Files are valid for their models; each tolerance stands in one, as a limit or with a reason."""
    path = shared(f"data/cad_nist_ctc/nist_ctc_0{number}_asme1_ap242.stp")
    found, text = as_written(path, tmp_path)
    found.check(scene(path))
    pmi = read_pmi(path)
    limits = {1: 16, 2: 16, 3: 17, 4: 71, 5: 1}[number]
    assert sum(len(f.limits) for f in found.features) == limits
    for t in pmi.tolerances:
        assert f"{t.characteristic} {round(t.mm, 4):g} mm" in text
        assert not t.name or f"{t.name}: " in text
    for size in (s for s in pmi.sizes if s.limits_mm):
        assert "{:.6g} to {:.6g}".format(*size.limits_mm) in text


def test_where_nothing_that_is_stated_can_be_judged_the_file_is_one_to_start_from(tmp_path: Path) -> None:
    plate = DrawnPlate()
    plate.tolerance("FLATNESS", "flat", 0.1, plate.aspect(plate.sides["top"]))
    (tmp_path / "plate.step").write_text(plate.whole())
    found, text = as_written(tmp_path / "plate.step", tmp_path)
    assert [f.name for f in found.features] == ["rename me"]
    assert "# Stated, but not judged here:\n#   flat: flatness 0.1 mm: " in text


def test_the_command_line_writes_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    target = tmp_path / "tolerances.yaml"
    assert main(["verify", str(PLATE), "--template", "-o", str(target)]) == 0
    assert yaml.safe_load(target.read_text())["features"]["hole 12 mm"]["position_mm"] == 0.15
    assert main(["verify", str(PLATE), "--template", "--datum", "A | C"]) == 2
    assert "unknown datum system 'A C'; did you mean 'A B C'?" in capsys.readouterr().err
    assert main(["verify", str(PLATE), "--list", "--datum", "A"]) == 2
    assert "--datum is given without --template" in capsys.readouterr().err


def test_a_model_that_states_nothing_is_told_where_a_datum_is_asked_for(capsys: pytest.CaptureFixture[str]) -> None:
    bracket = PLATE.parent / "bracket.stl"
    assert main(["verify", str(bracket), "--template", "--datum", "A"]) == 2
    assert "--datum is given of bracket.stl; expected a STEP AP242 file" in capsys.readouterr().err
    assert main(["verify", str(bracket), "--template"]) == 0
    assert "rename me" in capsys.readouterr().out
