"""What something before the part hides is neither missing nor too dark: that it stands there is said, and where."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from cadcam.geometry.rigid import Rigid
from cadcam.locate.photo import Photo
from cadcam.report.verify.json import VerificationOrigin, verification_as_json
from cadcam.report.verify.words import feature_notes, to_do
from cadcam.verify.deviations.deviation import State, Unclear
from cadcam.verify.inspection import Inspection, inspect
from cadcam.verify.judge import Verification, verify_part
from cadcam.verify.tolerances.tolerance import Feature, Limit, Quantity, Selection, Tolerances
from cadcam.verify.tolerances.verdict import Verdict

from ..report.test_verify_page import at
from .scene import CAMERA, NOISE, POSE, displaced, part, photo, photographed, plate

PAPER = 0.3  # grey of what stands before the part
ASKED = Tolerances(tuple(Feature(n, Selection(n), (Limit(Quantity.PRESENCE, 0.0),)) for n in ("block", "bracket")))


def behind_paper(along: float, level: float) -> Photo:
    """Return the photo of the plate with paper before it from `level` px right of the middle on, turned by `along`."""
    rng = np.random.default_rng(1)
    x, y = np.meshgrid(np.arange(480.0) - 239.5, np.arange(360.0) - 179.5)
    cover = gaussian_filter((x * np.cos(along) + y * np.sin(along) > level).astype(float), 0.6)
    picture = (1 - cover) * photographed(plate(), rng) + cover * (PAPER + rng.normal(0, NOISE, cover.shape))
    return Photo.of(np.asarray(np.clip(picture, 0, 1), np.float32), CAMERA, POSE)


@pytest.fixture(scope="module")
def hidden() -> tuple[Verification, Inspection]:
    """Return what is said of a plate whose block and bracket are behind paper."""
    found = verify_part(part(), [behind_paper(0.5, 20.0)], at(Rigid(), 1.0), ASKED)
    assert found.inspection is not None
    return found, found.inspection


def test_what_is_hidden_is_unclear_and_not_missing(hidden: tuple[Verification, Inspection]) -> None:
    found, seen = hidden
    assert found.verdict is Verdict.UNDECIDED
    for name in ("block", "bracket"):
        assert (seen.feature(name).state, seen.feature(name).why) == (State.UNCLEAR, Unclear.BEHIND), name
    assert seen.feature("rib 1").state is State.IN_PLACE


def test_a_corner_that_shows_is_enough_for_the_block_to_be_there() -> None:
    """Two of its seven edges, and its pixels, against tones that say that it is not there."""
    seen = inspect(part(), [behind_paper(0.5, 40.0)], Rigid())
    assert (seen.feature("block").state, seen.feature("block").presence.seen) == (State.IN_PLACE, 2)
    assert seen.feature("bracket").state is State.UNCLEAR


def test_it_is_said_where_it_stands_and_what_to_do(hidden: tuple[Verification, Inspection]) -> None:
    found, seen = hidden
    assert seen.covered is not None
    said = f"something stands before the part at its right and hides {seen.covered.share:.0%} of its edges"
    assert said in found.reason
    assert said in feature_notes(seen)
    assert to_do(found) == [("Take away what hides it, or take another view", ["block", "bracket"])]
    assert all("something stands before it" in j.reason and "light" not in j.reason for j in found.judgements)
    document = verification_as_json(found, VerificationOrigin("plate"))
    assert document["covered"] == {"share": seen.covered.share, "side": "right"}


def test_where_it_hides_too_much_that_is_the_reason() -> None:
    seen = inspect(part(), [behind_paper(np.pi / 2, 0.0)], Rigid())
    assert not seen.found
    assert "something stands before the part" in seen.reason
    assert "not this part" not in seen.reason


def test_where_the_rest_is_not_seen_either_the_part_is_not_there() -> None:
    """The paper's border hides some of the lines of a part that is elsewhere as well."""
    seen = inspect(part(), [behind_paper(np.pi / 2, 0.0)], Rigid.exp([0, 0, 0, 0.3, 0.2, 0.4]))
    assert not seen.found
    assert "before the part" not in seen.reason


def test_what_is_missing_is_still_missing() -> None:
    taken = photo(displaced("bracket", None), np.random.default_rng(1))
    found = verify_part(part(), [taken], at(Rigid(), 1.0), ASKED)
    assert found.inspection is not None
    assert found.inspection.feature("bracket").state is State.MISSING
    assert found.inspection.covered is None
    assert "before the part" not in found.reason
