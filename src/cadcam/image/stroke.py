"""What a line is drawn with, in pictures and in SVG alike: colour, width, opacity, dashes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from cadcam.arrays import frozen
from cadcam.errors import BadValue
from cadcam.kinds import expect_number

Color: TypeAlias = Sequence[float]  # red, green, blue in [0, 1]

_WIDEST = 1e4  # px
_SHORTEST = 0.5  # px: shorter dashes are no dashes, and too many to draw
_DASH = f"(on, off) lengths above 0 px, together at least {_SHORTEST:g} px"


def paint_of(color: Color, what: str = "color") -> npt.NDArray[np.float32]:
    """Return a colour (3,); `BadValue` naming it unless it is red, green and blue from 0 to 1."""
    paint = frozen(color, what, (3,), np.float32)
    if paint.min() < 0 or paint.max() > 1:
        raise BadValue(what, tuple(color), "red, green, blue from 0 to 1")
    return paint


def check_stroke(width: float, opacity: float, dash: tuple[float, float] | None, *, of: str = "") -> None:
    """Raise `BadValue` naming what no line can be drawn with: its width (px), opacity, or dashes (on, off) in px.

    of: what the names of width and opacity begin with.
    """
    expect_number(width, f"{of}width")
    if not 0 < width < _WIDEST:
        raise BadValue(f"{of}width", width, f"a line width above 0 and below {_WIDEST:.0f} px")
    expect_number(opacity, f"{of}opacity")
    if not 0 <= opacity <= 1:
        raise BadValue(f"{of}opacity", opacity, "0 (nothing) to 1 (opaque)")
    if dash is None:
        return
    lengths = frozen(dash, "dash", (None,))
    if len(lengths) != 2 or lengths.min() <= 0 or lengths.sum() < _SHORTEST:
        raise BadValue("dash", dash, _DASH)
