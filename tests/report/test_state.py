"""Stored records in a list: what is worst of each is what its verdict is due to."""

from __future__ import annotations

import pytest

from cadcam.record.record import Deviation, Record
from cadcam.report.state.tables import features_table, list_table, record_tables


@pytest.mark.parametrize(
    ("deviation", "lower", "upper", "says"),
    [
        (-0.3, 0.0, 1.0, "gap 160 %"),  # the limit beside it is 0: by that alone it would take up nothing
        (0.2, 0.5, 1.0, "gap 220 %"),  # below both limits: by the upper one alone it would take up 20 %
        (0.75, 0.5, 1.0, "face 50 %"),
        (0.9, -1.0, 1.0, "gap 90 %"),
        (-0.9, -1.0, None, "gap 90 %"),
        (0.9, None, 1.0, "gap 90 %"),
        (-9.0, None, 1.0, "face 50 %"),
        (-0.3, 0.0, None, "gap beyond its limit"),
        (0.3, 0.0, None, "face 50 %"),
        (-0.1, None, -0.2, "gap beyond its limit"),
        (0.1, 0.0, 0.0, "gap beyond its limit"),
        (9.0, None, None, "face 50 %"),
    ],
)
def test_the_worst_is_the_nearest_to_its_limits_or_farthest_beyond(
    deviation: float, lower: float | None, upper: float | None, says: str
) -> None:
    given = Deviation("gap", deviation, 0.01, lower=lower, upper=upper)
    face = Deviation("face", 0.5, 0.01, lower=-1.0, upper=1.0)
    table = list_table([Record("p", deviations=(face, given))], of=1)
    assert table.rows[0][-1] == says


@pytest.mark.parametrize(
    ("kind", "lower", "upper", "says"),
    [
        ("position", None, 0.25, "0.25 mm"),
        ("position", -0.25, 0.25, "0.25 mm"),
        ("diameter", -0.1, 0.25, "-0.1 to 0.25 mm"),
        ("diameter", None, 0.25, "up to 0.25 mm"),
        ("diameter", -0.25, None, "from -0.25 mm"),
        ("position", None, None, "none"),
    ],
)
def test_limits_are_told_as_verify_tells_them(kind: str, lower: float | None, upper: float | None, says: str) -> None:
    record = Record("p", deviations=(Deviation("gap", 0.1, 0.01, kind, lower=lower, upper=upper),))
    assert record_tables(record)[1].rows[0][3] == says
    assert features_table([record]).rows[0][-1] == ("" if says == "none" else says)
