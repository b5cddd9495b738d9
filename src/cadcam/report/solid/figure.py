"""A CAD model in a page, which a reader turns, cuts open and asks: what is under the pointer."""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from importlib.resources import files

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Array, Longs
from cadcam.cad.mesh import Mesh
from cadcam.geometry.rigid import Rigid
from cadcam.kinds import FrozenMap

_SCRIPTS = ("canvas.js", "solid.js", "figure.js")
HOW_TO_TURN = "Drag to turn it, with Shift to move it; click, then the wheel zooms. The pointer tells what it is on."
_MOST = 150_000  # faces that a page is made to carry: 4 MB; of more the lines alone are shown
_DIGITS = 5
CLEAR = 255
INK = "#202830"


@dataclass(frozen=True, slots=True)
class LineStyle:
    """How lines are drawn: colour ("#rrggbb"), width in px; through: dotted where they are hidden."""

    color: str = INK
    width: float = 1.0
    through: bool = False


@dataclass(frozen=True, slots=True)
class Mark:
    """A label at a point (3,) mm of the body, with an arrow from there `to` a point, if any."""

    at: Array
    text: str
    color: str = "#1c1c1c"
    to: Array | None = None


@dataclass(frozen=True, slots=True)
class Look:
    """A way to look at the body: its title, the camera's pose, and how much of it is in the picture.

    tall_mm: height of the picture; None: all of it, in its middle. cut: whether what lies before the camera is cut off.
    """

    title: str
    camera_from_body: Rigid
    tall_mm: float | None = None
    cut: bool = False


WHOLE = Look("whole", Rigid.look_at(np.array([1.0, -1.3, 0.9]), np.zeros(3)))


@dataclass(frozen=True, slots=True, eq=False)
class Paint:
    """A way to paint the body: its title, the colour (F,) of each face, `CLEAR` of those that are not filled.

    words: what each colour means, for the place under the pointer; none where that is said of the part.
    """

    title: str
    color: Longs
    words: Sequence[str] = ()


@dataclass(frozen=True, slots=True, eq=False)
class SolidFigure:
    """A body to be turned: its mesh, painted in one or several ways, its lines, and what is written beside it.

    said: of each of the mesh's parts, what is shown while the pointer is on it. colors (C): "#rrggbb", of the paints.
    lines (E, 2, 3) mm; style (E,): which of `styles`, later ones being drawn upon earlier ones. looks: the first is how
    it is shown at first.
    """

    mesh: Mesh
    said: Sequence[str]
    colors: Sequence[str]
    paints: Sequence[Paint]
    lines: Array
    styles: Sequence[LineStyle]
    style: Longs
    looks: Sequence[Look] = (WHOLE,)
    marks: Sequence[Mark] = ()

    def html(self, label: str, *, kind: str = "solid", more: Mapping[str, object] = FrozenMap()) -> str:
        """Return it as HTML; label: for who cannot see it. The page needs `solid_script` once, and `solid_style`.

        kind: of figure, one of `KINDS` in the page's scripts; more: what that one is told beside this.
        """
        buttons = "".join(f"<button>{escape(look.title)}</button>" for look in self.looks)
        titles = "".join(f"<option>{escape(paint.title)}</option>" for paint in self.paints)
        choice = f"<label>painted <select>{titles}</select></label>" if len(self.paints) > 1 else ""
        cut = '<label>cut open <input type="range" min="-1" max="1" step="0.005" value="-1"></label>'
        told = json.dumps({**self._told(), **more}, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
        return (
            f'<figure class="solid" data-kind="{kind}"><canvas role="img" aria-label="{escape(label)}"></canvas>'
            f'<div class="tools">{buttons}{choice}{cut}</div><script type="application/json">{told}</script></figure>'
        )

    def _told(self) -> dict[str, object]:
        n = self.mesh.n_faces if self.mesh.n_faces <= _MOST else 0
        points = np.concatenate([self.mesh.vertices[self.mesh.faces[:n].ravel()], self.lines.reshape(-1, 3)])
        every = np.concatenate([self.mesh.bounds, self.lines.reshape(-1, 3)])
        low, high = every.min(axis=0), every.max(axis=0)
        middle, radius = (low + high) / 2, max(float(np.linalg.norm(high - low)) / 2, 1e-12)
        vertices, index = np.unique(((points - middle) / radius).astype("<f4"), axis=0, return_inverse=True)
        index = index.reshape(-1).astype("<u4")
        return {
            "vertices": packed(vertices),
            "faces": packed(index[: 3 * n]),
            "part": packed(self.mesh.part[:n].astype("<u4")),
            "said": list(self.said),
            "colors": list(self.colors),
            "paints": [{"color": packed(p.color[:n].astype("u1")), "words": list(p.words)} for p in self.paints],
            "edges": packed(index[3 * n :]),
            "style": packed(self.style.astype("u1")),
            "styles": [{"color": s.color, "width": s.width, "through": s.through} for s in self.styles],
            "looks": [_look(look, middle, radius) for look in self.looks],
            "marks": [_mark(mark, middle, radius) for mark in self.marks],
        }


def solid_script(more: str = "") -> str:
    """Return the script that shows every figure of a page; more: scripts of other kinds of figures."""
    text = "\n".join([*((files(__package__) / name).read_text() for name in _SCRIPTS), more])
    return f'<script>"use strict";\n{text}</script>'


def solid_style() -> str:
    """Return the style of figures."""
    return (files(__package__) / "figure.css").read_text()


def _look(look: Look, middle: Array, radius: float) -> dict[str, object]:
    """Return a look in radii: the body's middle off the picture's, and the depth before which it is cut away."""
    off = np.round((look.camera_from_body @ middle) / radius, _DIGITS).tolist()
    return {
        "turn": np.round(look.camera_from_body.rotation, _DIGITS).ravel().tolist(),
        "tall": None if look.tall_mm is None else look.tall_mm / radius,
        "off": off[:2],
        "cut": -off[2] if look.cut else -1.0,
    }


def _mark(mark: Mark, middle: Array, radius: float) -> dict[str, object]:
    at, to = (None if p is None else np.round((p - middle) / radius, _DIGITS).tolist() for p in (mark.at, mark.to))
    return {"at": at, "to": to, "text": mark.text, "color": mark.color}


def packed(array: npt.NDArray[np.generic]) -> str:
    """Return the bytes of an array as base64, for a page's scripts."""
    return base64.b64encode(np.ascontiguousarray(array).tobytes()).decode()
