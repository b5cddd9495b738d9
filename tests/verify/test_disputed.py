"""Rigs with a camera that is not where its file says: no body of a good part is displaced for it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import pytest

from cadcam.cad.mesh import Mesh
from cadcam.geometry.rigid import Rigid
from cadcam.locate.location import Location
from cadcam.locate.photo import Photo
from cadcam.locate.refine.refinement import refine_pose
from cadcam.verify.deviations.deviation import State, Unclear
from cadcam.verify.judge import verify_part
from cadcam.verify.tolerances.tolerance import Feature, Limit, Quantity, Selection, Tolerances, whole_parts
from cadcam.verify.tolerances.verdict import Verdict

from .scene import CAMERA, POSE, displaced, part, photographed, plate

VIEWS = {
    "front": POSE,
    "left": Rigid.look_at((-620.0, -520.0, 500.0), (10.0, 0.0, 10.0)),
    "back": Rigid.look_at((300.0, 700.0, 560.0), (10.0, 0.0, 10.0)),
}
START = Rigid.exp(np.array([0.8, -0.5, 0.6, 0.002, -0.003, 0.002]))
LIMITS = (Limit(Quantity.PRESENCE, 0.0), Limit(Quantity.POSITION, 0.8))
ASKED = Tolerances(
    tuple(Feature(name, Selection(name), LIMITS) for name in ("rib 1", "rib 2", "block", "bracket")),
    (Selection("plate"),),
)


def rig(off: Mapping[str, Sequence[float]], *names: str, mesh: Mesh | None = None) -> list[Photo]:
    """Return photos by cameras that are told to stand so many mm beside where they do."""
    rng, photos = np.random.default_rng(1), []
    for name in names:
        gray = photographed(mesh or plate(), rng, VIEWS[name])
        told = VIEWS[name] @ Rigid(translation=off.get(name, (0.0, 0.0, 0.0)))
        photos.append(Photo.of(gray, CAMERA, told, name=name))
    return photos


def located(photos: Sequence[Photo]) -> Location:
    found = refine_pose(part(), photos, START)
    assert found.found
    return found


def states(photos: Sequence[Photo], found: Location) -> set[State]:
    """Return what becomes of the bodies, each of which is asked for."""
    seen = verify_part(part(), photos, found, whole_parts(part().scene)).inspection
    assert seen is not None
    return {f.state for f in seen.features}


def test_two_cameras_that_disagree_displace_no_body() -> None:
    photos, bodies = rig({"left": (-3.0, 0.0, 1.0)}, "front", "left"), whole_parts(part().scene)
    found = located(photos)
    exact = replace(found, disagreements=(), cameras_off_mm=0.0)
    assert State.DISPLACED in states(photos, exact)  # else this shows nothing
    assert State.DISPLACED not in states(photos, replace(exact, cameras_off_mm=found.cameras_off_mm))
    seen = verify_part(part(), photos, found, bodies).inspection
    assert seen is not None
    assert {(f.state, f.why) for f in seen.features} == {(State.UNCLEAR, Unclear.DISPUTED)}
    assert not any(e.off for e in seen.edges)


def test_their_verdict_is_undecided_and_says_why() -> None:
    photos = rig({"left": (1.0, 0.0, 0.0)}, "front", "left")
    verdict = verify_part(part(), photos, located(photos), ASKED)
    assert verdict.verdict is Verdict.UNDECIDED
    assert "the photos disagree" in verdict.reason
    assert "photo 'left' shows the part 0.2 px beside" in verdict.reason
    judged = {(j.limit.quantity, j.verdict) for j in verdict.judgements}
    assert judged == {(Quantity.POSITION, Verdict.UNDECIDED), (Quantity.PRESENCE, Verdict.PASS)}


def test_what_is_missing_is_so_for_both() -> None:
    photos = rig({"left": (1.2, 0.0, 0.0)}, "front", "left", mesh=displaced("block", None))
    found = located(photos)
    assert found.disputed
    verdict = verify_part(part(), photos, found, ASKED)
    assert verdict.verdict is Verdict.FAIL
    assert verdict.reason.startswith("block is missing; ")


def test_a_good_part_is_judged_by_the_cameras_that_agree() -> None:
    photos = rig({"left": (3.0, 1.0, 0.0)}, *VIEWS)
    found = located(photos)
    exact = replace(found, disagreements=(), cameras_off_mm=0.0)
    assert verify_part(part(), photos, exact, ASKED).verdict is Verdict.UNDECIDED
    verdict = verify_part(part(), photos, found, ASKED)
    assert verdict.verdict is Verdict.PASS
    assert "photo 'left' shows" in verdict.reason
    assert verdict.reason.endswith("and was left out")
    assert verdict.inspection is not None
    assert {e.photo for e in verdict.inspection.edges} == {0, 2}


@pytest.mark.parametrize(
    ("off", "names"),
    [
        ((0.5, 0.0, 0.0), ("front", "left")),
        pytest.param((0.25, 0.0, 0.0), tuple(VIEWS), marks=pytest.mark.slow),
    ],
)
def test_cameras_are_judged_by_that_are_off_by_no_more_than_calibrations_are(
    off: tuple[float, float, float], names: tuple[str, ...]
) -> None:
    """0.1 to 0.2 px, of cameras without a covariance: what they are off is told from the photos, and is part of U."""
    photos = rig({"left": off}, *names)
    found = located(photos)
    assert found.disagreements == ()
    rms = np.linalg.norm(off) / np.sqrt(6 * len(names))  # of places and directions, along each axis
    assert rms / 3 < found.cameras_off_mm < 3 * rms
    told, exact = (verify_part(part(), photos, f, ASKED) for f in (found, replace(found, cameras_off_mm=0.0)))
    assert told.verdict is Verdict.PASS
    for one, other in zip(told.judgements, exact.judgements, strict=True):
        if one.limit.quantity is Quantity.POSITION:
            assert one.U > 1.1 * other.U
            assert one.deviation < 1.5 * one.U
    assert State.DISPLACED not in states(photos, found)


def test_a_body_that_is_displaced_is_found_by_cameras_that_are_off_by_little() -> None:
    photos = rig({"left": (0.25, 0.0, 0.0)}, *VIEWS, mesh=displaced("rib 1", np.array([0.0, 2.0, 0.0])))
    found = located(photos)
    assert found.disagreements == ()
    assert found.cameras_off_mm > 0
    verdict = verify_part(part(), photos, found, ASKED)
    assert verdict.verdict is Verdict.FAIL
    assert verdict.reason.startswith("rib 1 is ")


def test_a_body_that_is_displaced_makes_no_photos_disagree() -> None:
    photos = rig({}, *VIEWS, mesh=displaced("rib 1", np.array([0.0, 2.0, 0.0])))
    found = located(photos)
    assert found.disagreements == ()
    verdict = verify_part(part(), photos, found, ASKED)
    assert verdict.verdict is Verdict.FAIL
    assert verdict.reason.startswith("rib 1 is ")


def test_cameras_that_agree_are_not_doubted() -> None:
    photos = rig({}, *VIEWS)
    found = located(photos)
    assert found.disagreements == ()
    verdict = verify_part(part(), photos, found, ASKED)
    assert verdict.reason == "all 8 limits are kept, uncertainty included"
