"""Of two edges of a part that may look like one, the one that is not seen does not speak against the part."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from cadcam.verify.edges.presence import _merged


def lines(apart: float, *, parts: tuple[int, int] = (0, 0), photos: tuple[int, int] = (0, 0)) -> SimpleNamespace:
    """Return ten places each of two parallel edges."""
    x = 4.0 * np.arange(10)
    q = np.concatenate([np.column_stack([x, np.zeros(10)]), np.column_stack([x + 1, np.full(10, apart)])])
    each = [np.repeat(v, 10) for v in (parts, photos, (0, 1))]
    return SimpleNamespace(q=q, part=each[0], photo=each[1], edge=each[2])


@pytest.mark.parametrize(
    ("apart", "more", "dropped"),
    [(3.0, {}, True), (6.0, {}, False), (3.0, {"parts": (0, 1)}, False), (3.0, {"photos": (0, 1)}, False)],
)
def test_an_edge_close_beside_one_of_its_part_that_is_seen_is_no_evidence(
    apart: float, more: dict[str, tuple[int, int]], dropped: bool
) -> None:
    places = [np.arange(10), np.arange(10, 20)]
    given = lines(apart, **more)
    assert _merged(given, places, np.array([True, False])).tolist() == [False, dropped]
    assert _merged(given, places, np.array([False, True])).tolist() == [dropped, False]
    for seen in (True, False):  # both are evidence where both are seen, or neither
        assert not _merged(given, places, np.array([seen, seen])).any()
