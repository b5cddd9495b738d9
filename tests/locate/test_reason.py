"""The reason of a pose: what later steps exchange in it, and what they add."""

from __future__ import annotations

from cadcam.locate.reason import Reason, Refusal

SEEN = Reason("6 of 7 edges", known="position within 0.1 mm in any direction")


def test_what_is_noted_follows_how_well_the_pose_is_known_whatever_that_becomes() -> None:
    told = SEEN.noting("the photos disagree").knowing("position within 3 mm in any direction").noting("it is blurred")
    assert str(told) == "6 of 7 edges; position within 3 mm in any direction; the photos disagree; it is blurred"


def test_a_pose_that_is_refused_is_so_first_whatever_spoke_for_it() -> None:
    refused = SEEN.refused(Refusal.NOT_CERTAIN, "two places look alike").knowing("least certain along x, 2 mm")
    assert str(refused) == "not certain: two places look alike (6 of 7 edges; least certain along x, 2 mm)"
    assert refused.bare == "two places look alike (6 of 7 edges; least certain along x, 2 mm)"


def test_a_reason_that_does_not_say_how_well_the_pose_is_known_is_not_made_to() -> None:
    none = Reason("too few lines", Refusal.NOT_FOUND)
    assert str(none.knowing("position within 1 mm in any direction")) == "not found: too few lines"
