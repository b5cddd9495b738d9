"""A picture and an SVG refuse the same colours, widths, opacities and dashes, by the same words."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from cadcam.errors import BadValue
from cadcam.image.draw import draw_polylines
from cadcam.image.svg import SvgLayer

LINE = np.array([[0.0, 0.0], [5.0, 5.0]])
WRONG: list[dict[str, Any]] = [
    *({"color": color} for color in ((2, 0, 0), (0.5,), "red", (math.nan, 0, 0))),
    *({"width": width} for width in (0, -1, 1e4, math.nan, math.inf, "thin")),
    *({"opacity": opacity} for opacity in (-0.1, 1.1, math.nan, None)),
    *({"dash": dash} for dash in ((0, 3), (0.2, 0.2), (6, -4), (6,), (6, 4, 2), (math.inf, 1), "6,4", 6)),
]


@pytest.mark.parametrize("wrong", WRONG, ids=str)
def test_one_rule_holds_for_both(wrong: dict[str, Any]) -> None:
    given = {"color": (0, 0, 0), **wrong}
    with pytest.raises(BadValue, match=rf"^{next(iter(wrong))}\b.* is ") as in_picture:
        draw_polylines(np.zeros((20, 20)), [LINE], **given)
    with pytest.raises(BadValue) as in_svg:
        SvgLayer("x", [LINE], **given)
    assert str(in_picture.value) == str(in_svg.value)


def test_what_one_draws_the_other_does() -> None:
    for given in ({"dash": (0.3, 0.2)}, {"dash": np.array([6.0, 4.0])}, {"width": 9999, "opacity": 0}):
        draw_polylines(np.zeros((20, 20)), [LINE], color=(0, 0.5, 1), **given)  # type: ignore[arg-type]
        SvgLayer("x", [LINE], (0, 0.5, 1), **given)  # type: ignore[arg-type]
