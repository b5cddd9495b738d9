"""Where a part may be there several times, places in the photo share what a search keeps; where once, the best are."""

from __future__ import annotations

import numpy as np

from cadcam.locate.search.quota import MANY, ONCE, Quota, places_of


def test_a_part_that_is_there_once_may_take_all_the_room(rng: np.random.Generator) -> None:
    score, place = rng.normal(size=500), np.zeros(500, np.int64)
    assert np.array_equal(ONCE.best(score, place, 40), np.argsort(-score)[:40])


def test_no_place_takes_more_than_its_share_and_the_best_of_each_are_kept(rng: np.random.Generator) -> None:
    quota, place = Quota(2, 0.1), np.repeat(np.arange(6), [300, 100, 50, 3, 2, 1])
    score = rng.normal(size=len(place)) - place  # the first place crowds out the others
    kept = quota.best(score, place, 20)
    assert (np.diff(score[kept]) <= 0).all()
    assert np.bincount(place[kept]).tolist() == [4, 4, 4, 3, 2, 1]  # 0.1 of 2 * 20
    for number in range(6):
        mine = np.flatnonzero(place == number)
        best = mine[np.argsort(-score[mine])][:4]
        assert set(best) == set(kept[place[kept] == number])


def test_no_more_are_kept_than_there_is_room_for(rng: np.random.Generator) -> None:
    place = np.arange(1000)
    assert len(MANY.best(rng.normal(size=1000), place, 50)) == MANY.of(50)


def test_a_place_is_a_cell_of_directions() -> None:
    middle = np.array([[10.0, 10, 100], [100, 100, 1000], [30, 10, 100], [-1, 10, 100]])  # tangents 0.1, 0.1, 0.3, < 0
    first, same, beside, other = places_of(middle, 0.2).tolist()
    assert first == same
    assert len({first, beside, other}) == 3
