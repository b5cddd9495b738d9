"""A page on which a person clicks corners of a CAD model and their places in a photo; it loads nothing else.

What is picked leaves it as a points file (`files.points`). The scripts lie beside this module.
"""

from __future__ import annotations

import base64
import hashlib
import json
import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from importlib.resources import files
from itertools import count
from pathlib import Path

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Array, Picture
from cadcam.cad.corners import corner_vertices
from cadcam.cad.rims import rim_centers
from cadcam.camera.observations import Observations
from cadcam.errors import BadValue
from cadcam.image.picture import checked, encoded
from cadcam.kinds import expect, expect_names, expect_path, said
from cadcam.render.view import Scene
from cadcam.report import solid
from cadcam.report.page import page, section
from cadcam.whole import utf8, write_whole

_SHARED, _OWN = ("canvas.js", "solid.js"), ("model_pane.js", "photo_pane.js", "fit.js", "pick.js")
_LOSSLESS = 3_000_000  # px of a photo that is kept as PNG; larger ones as JPEG, which nobody can tell by eye
_DIGITS = 8  # of coordinates, in all
_SAME = 1e-6  # of the model's size: a point of a points file is this corner
_TOOLS = (
    '<p id="status" role="status"></p><div class="tools"><button id="save">Save points.csv</button>'
    '<button id="copy">Copy</button><button id="clear">Remove all</button><button id="whole">Whole photo</button>'
    '<label><input type="checkbox" id="lines" checked> lines of the model as the picks have it</label></div>'
)
_AFTER = (
    "<p>Six corners or more that are not all in one plane give the camera; four are enough where its internals are"
    " known. Spread them over the whole photo, near and far. The middle of a round edge (O) is only about the"
    " middle of what is seen of it, as near things look larger.</p>"
    "<p><code>cadcam calibrate points.csv --photo PHOTO -o camera.json</code></p>"
)


def write_pick_page(
    path: str | os.PathLike[str],
    photo: npt.ArrayLike,
    scene: Scene,
    *,
    picked: Observations | None = None,
    names: tuple[str, str] = ("photo", "model"),
) -> int:
    """Write the page, whole or not at all; return how many points of the model it offers.

    photo: (H, W) or (H, W, 3), white at 1. picked: what was picked before, to go on with; points that are no corner of
    the model are offered, too. names: of the photo's and the model's file, for the text. Raises `BadValue` where the
    model has neither corners nor round edges, or a picked point lies outside of the photo.
    """
    expect_path(path)
    expect(scene, "scene", Scene)
    expect(picked, "picked", Observations, optional=True)
    if len(expect_names(names, "names")) != 2:
        raise BadValue("names", said(names), "two: of the photo and of the model")
    picture = checked(photo)
    offer = _Offer.of(scene, picked, picture)
    write_whole(path, utf8(_page(picture, scene, offer, names)))
    return len(offer.points)


@dataclass(frozen=True, slots=True, eq=False)
class _Offer:
    """The points (N, 3) mm to choose from, their names, and what was picked before: point, x, y."""

    points: Array
    names: list[str]
    picked: list[tuple[int, float, float]]

    @classmethod
    def of(cls, scene: Scene, picked: Observations | None, picture: Picture) -> _Offer:
        mesh = scene.mesh
        corners, rims = corner_vertices(mesh, scene.edges), rim_centers(mesh, scene.edges)
        points, before = np.concatenate([corners, rims]), []
        named: dict[int, str] = {}
        if picked is not None:
            _check_inside(picked, picture)
            for name, p, (x, y) in zip(picked.names, picked.p_world, picked.q.tolist(), strict=True):
                off = np.linalg.norm(points - p, axis=1)
                k = int(np.argmin(off)) if len(off) else -1
                if k < 0 or off[k] > _SAME * float(np.linalg.norm(mesh.size_mm)):
                    points, k = np.concatenate([points, p[None]]), len(points)
                named[k] = name
                before.append((k, x, y))
        if not len(points):
            raise BadValue("model", "without any corner or round edge", "a part with edges")
        kinds = ["C"] * len(corners) + ["O"] * len(rims) + ["P"] * (len(points) - len(corners) - len(rims))
        return cls(points, _names(kinds, named), before)


def _names(kinds: Sequence[str], named: Mapping[int, str]) -> list[str]:
    """Return a name of each point, all different: the given ones, and its kind with a number of the others."""
    numbers, taken = count(1), set(named.values())
    others = [next(name for n in numbers if (name := f"{kind}{n}") not in taken) for kind in kinds]
    return [named.get(k) or other for k, other in enumerate(others)]


def _check_inside(picked: Observations, picture: Picture) -> None:
    height, width = picture.shape[:2]
    outside = np.flatnonzero(((picked.q < -0.5) | (picked.q > (width - 0.5, height - 0.5))).any(axis=1))
    if len(outside):
        k = int(outside[0])
        raise BadValue(
            f"point {picked.names[k] or k + 1!r}", picked.q[k].tolist(), f"within the photo, {width} x {height} px"
        )


def _page(picture: Picture, scene: Scene, offer: _Offer, names: tuple[str, str]) -> str:
    form = "PNG" if picture.shape[0] * picture.shape[1] <= _LOSSLESS else "JPEG"
    data, model = encoded(picture, form), _model(scene, offer.points)
    decimals = _decimals(scene)
    told = {
        "corners": np.round(offer.points, decimals).tolist(),
        "decimals": decimals,
        "names": offer.names,
        "picked": offer.picked,
        "key": "cadcam pick " + hashlib.sha256(data + json.dumps(model).encode()).hexdigest()[:16],
        **model,
    }
    photo, part = (Path(name).name for name in names)
    image = f'<img id="picture" alt="{escape(photo)}" src="data:image/{form.lower()};base64,{_base64(data)}">'
    scripts = [files(solid) / name for name in _SHARED] + [files(__package__) / name for name in _OWN]
    script = "\n".join(path.read_text() for path in scripts)
    return page(
        f"Corners of {part} in {photo}",
        (files(__package__) / "pick.css").read_text(),
        [
            _panes(escape(part), escape(photo), image),
            section("", _TOOLS + _table()),
            section("Then", _AFTER),
            f'<script type="application/json" id="told">{_inline(told)}</script>',
            f'<script>"use strict";\n{script}</script>',
        ],
    )


def _panes(part: str, photo: str, image: str) -> str:
    return (
        '<div class="panes">'
        f"<figure><figcaption>{part}: click a corner. Dragging turns it (Shift: moves it), the wheel zooms."
        '</figcaption><canvas id="model"></canvas></figure>'
        f"<figure><figcaption>{photo}: click where it is. Dragging moves the photo, or a mark; the wheel zooms."
        f'</figcaption><canvas id="photo"></canvas>{image}</figure></div>'
    )


def _table() -> str:
    heads = "".join(f"<th>{head}</th>" for head in ("point", "X mm", "Y mm", "Z mm", "x px", "y px", "off, px", ""))
    return f'<table><thead><tr>{heads}</tr></thead><tbody id="rows"></tbody></table>'


def _model(scene: Scene, points: Array) -> dict[str, object]:
    """Return the mesh as the page draws it: about its middle, of radius 1, in single precision."""
    mesh, edges = scene.mesh, scene.edges
    low, high = mesh.bounds
    middle, radius = (low + high) / 2, max(float(np.linalg.norm(high - low)) / 2, 1e-12)
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    normals = np.concatenate([np.cross(b - a, c - a), np.full((1, 3), np.nan)])  # the last: of no face
    return {
        "middle": [*middle.tolist(), radius],
        "vertices": _base64(((mesh.vertices - middle) / radius).astype("<f4")),
        "faces": _base64(mesh.faces.astype("<u4")),
        "edges": _base64(edges.vertices.astype("<u4")),
        "normals": _base64(normals[edges.faces].astype("<f4")),
        "placed": _base64(((points - middle) / radius).astype("<f4")),
    }


def _decimals(scene: Scene) -> int:
    """Return how many decimals of a mm are worth writing, for the largest coordinate."""
    largest = float(np.abs(scene.mesh.bounds).max())
    return min(max(_DIGITS - 1 - math.floor(math.log10(max(largest, 1e-6))), 0), 12)


def _inline(told: object) -> str:
    """Return JSON that may stand within a script element, whatever names it holds."""
    return json.dumps(told, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")


def _base64(data: bytes | npt.NDArray[np.generic]) -> str:
    return base64.b64encode(data if isinstance(data, bytes) else np.ascontiguousarray(data).tobytes()).decode()
