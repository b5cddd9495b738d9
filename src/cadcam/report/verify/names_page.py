"""A page on which a part's bodies and edges are clicked, for features of a tolerance file; it loads nothing else."""

from __future__ import annotations

from html import escape
from importlib.resources import files

import numpy as np

from cadcam.cad.edges import EdgeKind
from cadcam.image.svg import hex_color
from cadcam.render.overlay import PART_COLORS
from cadcam.render.view import Scene
from cadcam.report.page import page, section
from cadcam.report.solid.figure import (
    CLEAR,
    HOW_TO_TURN,
    WHOLE,
    LineStyle,
    Paint,
    SolidFigure,
    packed,
    solid_script,
    solid_style,
)
from cadcam.verify.tolerances.tolerance import Selection

_CHOSEN = "#e07b00"
_PALE = 0.55  # of white in the bodies' colours
_STYLE = (
    "pre{background:#f4f4f1;padding:10px;border-radius:6px;overflow:auto}#copy,#none{font:inherit;padding:4px 12px}"
)
_STYLE += "figure.solid canvas{cursor:crosshair}"
_HOW = "Click edges, or bodies. What is chosen stands below as a tolerance file has it; 1 mm is to be edited."


def names_page(scene: Scene, title: str, chosen: Selection | None = None) -> str:
    """Return the page; chosen: of these bodies alone, the others not shown."""
    mesh, edges = scene.mesh, scene.edges
    shown = np.ones(len(mesh.part_names), bool) if chosen is None else chosen.bodies(scene)
    lines = np.flatnonzero(shown[edges.part])
    pale = [hex_color([_PALE + (1 - _PALE) * c for c in color]) for color in PART_COLORS]
    paint = np.where(shown[mesh.part], 1 + mesh.part % len(pale), CLEAR).astype(np.int64)
    figure = SolidFigure(
        mesh,
        mesh.part_names,
        [_CHOSEN, *pale],
        [Paint("parts", paint)],
        mesh.vertices[edges.vertices[lines]],
        [LineStyle(width=1.5), LineStyle(_CHOSEN, 4.0, through=True)],
        np.zeros(len(lines), np.int64),
        [WHOLE],
    )
    more = {
        "names": list(mesh.part_names),
        "chain": packed(edges.chain[lines].astype("<u4")),
        "of": packed(edges.part[lines].astype("<u4")),
        "words": _words(scene),
    }
    script = (files(__package__) / "names.js").read_text()
    body = figure.html("the part, whose edges and bodies can be clicked", kind="names", more=more)
    body += f'<p class="soft">{escape(_HOW)} {escape(HOW_TO_TURN)}</p><pre id="entries"></pre>'
    body += '<button id="copy">Copy</button> <button id="none">Choose nothing</button>'
    parts = [section(f"Names in {title}", body), solid_script(script)]
    return page(f"Names in {title}", solid_style() + _STYLE, parts)


def _words(scene: Scene) -> list[str]:
    """Return what is said of each chain, by its number: its kind and length."""
    edges = scene.edges
    length = np.bincount(edges.chain, edges.lengths(scene.mesh))
    kind = np.zeros(len(length), np.int64)
    kind[edges.chain] = edges.kind
    return [f"{EdgeKind(int(k)).name.lower()}, {n:.1f} mm" for k, n in zip(kind, length, strict=True)]
