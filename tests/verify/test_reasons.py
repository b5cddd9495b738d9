"""Whoever stands by the part is told which feature, its value, U and limit, and what would decide it."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage

from cadcam.geometry.rigid import Rigid
from cadcam.locate.freedom import FREE, Freedom
from cadcam.locate.location import Location
from cadcam.locate.reason import Reason, Refusal
from cadcam.locate.refine.refinement import refine_pose
from cadcam.verify.adjustment.datum_fit import CAUSES
from cadcam.verify.deviations.deviation import Unclear
from cadcam.verify.judge import Verification, verify_part
from cadcam.verify.reasons import explained, shown_decimals, summary, with_remedy
from cadcam.verify.tolerances.tolerance import Feature, Limit, Quantity, Rule, Selection, Tolerances, whole_parts
from cadcam.verify.tolerances.verdict import Judgement, Verdict, decided

from .scene import displaced, part, photo, plate

SHARES = dict(zip(CAUSES, (0.1, 0.1, 0.1, 0.7), strict=True))


def judgement(value: float, sigma: float, limit: Limit, reason: str = "displaced") -> Judgement:
    """Return a measured judgement with its explanation."""
    j = Judgement("rib", limit, value, sigma, decided(value, sigma, limit), reason)
    return with_remedy(explained(j, SHARES))


POSITION = Limit(Quantity.POSITION, 0.5)
ALONG = Limit(Quantity.POSITION, 0.05, direction=(0.0, 1.0, 0.0))
CALIBRATION = "most of U is camera calibration (70%): calibrate the camera better"


@pytest.mark.parametrize(
    ("value", "sigma", "limit", "row", "line"),
    [
        (
            *(0.2, 0.2, POSITION),
            f"displaced; 0.30 mm within the limit, which is less than U; {CALIBRATION}",
            "rib is 0.20 +- 0.40 mm off its place, limit 0.5 mm: calibrate the camera better",
        ),
        (
            *(0.6, 0.1, POSITION),
            f"displaced; 0.10 mm beyond the limit, which is less than U; {CALIBRATION}",
            "rib is 0.60 +- 0.20 mm off its place, limit 0.5 mm: calibrate the camera better",
        ),
        (
            *(0.02, 0.04, ALONG),
            f"displaced; U is not below the limit, so not even a feature in place passes; {CALIBRATION}",
            "rib is 0.020 +- 0.080 mm off its place along y, limit 0.05 mm: calibrate the camera better",
        ),
        (
            *(0.1, 0.1, Limit(Quantity.POSITION, 0.5, rule=Rule.SIMPLE)),
            f"displaced; U is more than 33% of the limit; {CALIBRATION}",
            "rib is 0.10 +- 0.20 mm off its place, limit 0.5 mm: calibrate the camera better",
        ),
        (
            *(np.radians(0.2), np.radians(0.2), Limit(Quantity.ANGLE, np.radians(0.5))),
            f"displaced; 0.30 deg within the limit, which is less than U; {CALIBRATION}",
            "rib is turned by 0.20 +- 0.40 deg, limit 0.5 deg: calibrate the camera better",
        ),
    ],
)
def test_what_u_leaves_open_says_by_how_much_and_what_makes_u(
    value: float, sigma: float, limit: Limit, row: str, line: str
) -> None:
    j = judgement(value, sigma, limit)
    assert (j.verdict, j.reason) == (Verdict.UNDECIDED, row)
    assert summary(Verdict.UNDECIDED, [j]) == line


def test_a_failure_says_what_is_beyond_doubt() -> None:
    j = judgement(1.0, 0.1, POSITION)
    assert j.reason == "displaced; beyond the limit by 0.30 mm at least"
    simple = Limit(Quantity.POSITION, 0.5, rule=Rule.SIMPLE)
    assert judgement(0.55, 0.05, simple).reason == "displaced; beyond the limit by 0.05 mm"  # less than U
    also = judgement(0.2, 0.2, POSITION)
    said = "rib is 1.00 +- 0.20 mm off its place, limit 0.5 mm; 1 more limit cannot be decided"
    assert summary(Verdict.FAIL, [j, also]) == said


def test_a_part_that_passes_by_one_photo_is_not_said_to_be_in_place_along_the_line_of_sight() -> None:
    no_depth = "; how far parts are off along the line of sight one photo does not show"
    for limit, one_photo, said in ((POSITION, True, no_depth), (POSITION, False, ""), (ALONG, True, "")):
        j = judgement(0.01, 0.001, limit)
        assert summary(j.verdict, [j], one_photo=one_photo) == f"the limit is kept, uncertainty included{said}"


def test_what_was_not_measured_is_named_once_for_each_reason() -> None:
    def unseen(name: str, quantity: Quantity) -> Judgement:
        j = Judgement(name, Limit(quantity, 1.0), np.nan, np.nan, Verdict.UNDECIDED, "unseen", "more light")
        return with_remedy(explained(j, {}))

    four = [unseen("rib", Quantity.POSITION), unseen("rib", Quantity.PROFILE)]
    four += [unseen(name, Quantity.POSITION) for name in ("web", "pin", "nut")]
    assert summary(Verdict.UNDECIDED, four) == (
        "rib: position and profile cannot be decided (unseen: more light); web, pin, nut: position cannot be decided "
        "(unseen: more light)"
    )


@pytest.mark.parametrize(
    ("unseen", "seen", "of_another"),
    [(2, 4, True), (2, 5, False), (1, 0, False), (4, 4, True)],
)
def test_where_many_features_are_unseen_it_may_be_another_revision(unseen: int, seen: int, of_another: bool) -> None:
    """As where holes were never drilled in a smooth plate, which light does not help; beside what fails, too."""
    why = Unclear.UNSEEN
    assert why.remedy == "is it there? else give more light, or light from another side"
    gone = [
        with_remedy(Judgement(f"H{i}", limit, np.nan, np.nan, Verdict.UNDECIDED, why.value, why.remedy))
        for i in range(unseen)
        for limit in (POSITION, Limit(Quantity.PRESENCE, 0.0))
    ]
    rest = [replace(judgement(0.1, 0.01, POSITION), feature=f"rib {i}") for i in range(seen)]
    asks = "; is it another revision of the part?"
    assert summary(Verdict.UNDECIDED, [*gone, *rest]).endswith(asks) is of_another
    rest = [replace(judgement(1.0, 0.1, POSITION), feature=f"rib {i}") for i in range(seen)]
    assert summary(Verdict.FAIL, [*gone, *rest]).endswith(asks) is of_another


def asked(limit_mm: float) -> Tolerances:
    """Return limits of all kinds on two ribs."""
    limits = [Limit(Quantity.POSITION, limit_mm), Limit(Quantity.PROFILE, limit_mm), Limit(Quantity.ANGLE, 1e-4)]
    limits += [Limit(Quantity.PRESENCE, 1.0)]
    return Tolerances(tuple(Feature(f"rib {k}", Selection(f"rib {k}"), tuple(limits)) for k in (1, 2)))


def verified(limit_mm: float, by: float, blur: float = 0.0) -> Verification:
    """Return the verification of the plate with rib 1 `by` mm off, in a photo blurred by some px."""
    seen = photo(displaced("rib 1", np.array([0.0, by, 0.0])) if by else plate(), np.random.default_rng(5))
    if blur:
        seen = type(seen)(np.asarray(ndimage.gaussian_filter(seen.gray, blur), np.float32), seen.viewpoint)
    return verify_part(part(), [seen], refine_pose(part(), [seen], Rigid()), asked(limit_mm))


@pytest.mark.parametrize("limit_mm", [0.02, 0.3, 1.4])
@pytest.mark.parametrize("by", [0.0, 1.5])
def test_every_undecided_limit_of_a_part_ends_with_what_would_decide_it(limit_mm: float, by: float) -> None:
    found = verified(limit_mm, by)
    undecided = [j for j in found.judgements if j.verdict is Verdict.UNDECIDED]
    assert undecided  # the angle's limit is finer than any photo's U
    for j in undecided:
        assert j.remedy
        assert j.reason.endswith(j.remedy.removeprefix("measure it more surely: "))
    for j in found.judgements:
        if j.verdict is Verdict.FAIL and np.isfinite(j.sigma):
            assert "beyond the limit by" in j.reason
    if found.verdict is Verdict.UNDECIDED:
        assert "+-" in found.reason
        assert "limit" in found.reason


def test_without_limits_what_is_displaced_is_said_all_the_same() -> None:
    """As the README does: every part of the model, no limits."""
    for by, says in ((0.0, "nothing was judged$"), (1.5, r"judged; rib 1 is 1\.\d\d \+- 0\.\d\d mm off its place$")):
        seen = photo(displaced("rib 1", np.array([0.0, by, 0.0])) if by else plate(), np.random.default_rng(5))
        found = verify_part(part(), [seen], refine_pose(part(), [seen], Rigid()), whole_parts(part().scene))
        assert found.verdict is Verdict.UNDECIDED
        assert re.search(says, found.reason)


def test_a_part_that_is_not_found_says_what_is_wrong_with_its_photo() -> None:
    found = verified(0.5, 0.0, blur=9.0)
    assert found.verdict is Verdict.NOT_FOUND
    assert found.reason.startswith("the part was not found: ")
    assert found.reason.count("not found") == 1
    assert "photo: it is out of focus or moved: its sharpest edges are blurred by" in found.reason


def test_a_part_that_is_not_found_where_its_motion_was_restricted_asks_for_that() -> None:
    seen = photo(displaced("rib 1", np.zeros(3)), np.random.default_rng(5))
    why = Reason("nothing around the start holds", Refusal.NOT_FOUND, around_start=True)
    nowhere = Location.nowhere(Rigid(), why)
    asked = "nothing around the start holds; is it this part, this camera, not mirrored, all in view"
    for freedom, said in ((FREE, ""), (Freedom.planar([0, 0, 1]), ", moved from there only as stated")):
        found = verify_part(part(), [seen], nowhere, whole_parts(part().scene), freedom=freedom)
        assert f"{asked}, near enough to the start{said}?" in found.reason


@pytest.mark.parametrize(("U", "decimals"), [(0.02, 2), (0.005, 2), (0.0049, 3), (0.0004, 4), (0.0, 2), (np.nan, 2)])
def test_an_uncertainty_is_never_written_as_nothing(U: float, decimals: int) -> None:
    assert shown_decimals(2, U) == decimals
    if U > 0:
        assert float(f"{U:.{decimals}f}") > 0
