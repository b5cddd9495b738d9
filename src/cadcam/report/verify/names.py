"""The names in a part that a tolerance file may use: tables, and a picture with the names."""

from __future__ import annotations

import numpy as np

from cadcam.arrays import Array, Picture
from cadcam.cad.edges import EdgeKind
from cadcam.camera.camera import Camera
from cadcam.geometry.rigid import Rigid
from cadcam.image.draw import draw_polylines, draw_text
from cadcam.render.lines.visible import LineDrawer
from cadcam.render.lines.wireframe import LineOptions, Polylines, Wireframe
from cadcam.render.overlay import PART_COLORS
from cadcam.render.view import Scene
from cadcam.report.table import Table
from cadcam.verify.tolerances.tolerance import Selection, runs

_HALO = (0.0, 0.0, 0.0)
_AROUND = np.array([[-1.0, 0.0], [1.0, 0.0], [0.0, -1.0], [0.0, 1.0]])
_LETTER = 0.6  # width of a letter over its height
_LEAST_PX = 8.0  # a line shorter than this gets no label


def part_table(scene: Scene) -> Table:
    """Return the parts with their boxes (mm) and the numbers of their chains."""
    edges, at = scene.edges, scene.mesh.vertices
    rows = []
    for number, name in enumerate(scene.mesh.part_names):
        used = at[scene.mesh.faces[scene.mesh.part == number]].reshape(-1, 3)
        mine = edges.part == number
        box = f"{_point(used.min(axis=0))} to {_point(used.max(axis=0))}" if len(used) else ""
        rows.append((name, box, str(len(np.unique(edges.chain[mine]))), _short(runs(np.unique(edges.chain[mine])))))
    return Table(
        "Parts",
        ("part", "box mm", "edges", "chains"),
        tuple(rows),
        ("part", "box mm", "chains"),
        ("part: may be a pattern, 'longitudinal *'; box_mm: [[x, y, z], [x, y, z]] in these axes narrows it",),
    )


def chain_table(scene: Scene, chosen: Selection) -> Table:
    """Return the chains (edges) of the parts of a selection: number, kind, length and ends in mm."""
    edges, mesh = scene.edges, scene.mesh
    bodies = chosen.bodies(scene)
    length = edges.lengths(mesh)
    rows = []
    for chain in np.unique(edges.chain[bodies[edges.part]]):
        mine = np.flatnonzero(edges.chain == chain)
        ends = mesh.vertices[[edges.vertices[mine[0], 0], edges.vertices[mine[-1], 1]]]
        kind = EdgeKind(int(edges.kind[mine[0]])).name.lower()
        name = mesh.part_names[int(edges.part[mine[0]])]
        rows.append((str(chain), name, kind, f"{length[mine].sum():.1f}", _point(ends[0]), _point(ends[1])))
    return Table(
        f"Edges of {chosen.part}",
        ("chain", "part", "kind", "mm", "from", "to"),
        tuple(rows),
        ("part", "kind", "from", "to"),
        ("chains: [...] and kinds: [...] choose among them; numbers hold for this CAD file as it is",),
    )


def names_over_photo(
    photo: Picture, drawer: LineDrawer, camera: Camera, camera_from_part: Rigid, chosen: Selection | None
) -> Picture:
    """Return the photo (H, W, 3) with the visible lines of each part in a colour and its name beside.

    chosen: of these parts alone, with the numbers of their chains.
    """
    return _named(photo, drawer.draw(camera, camera_from_part), drawer.scene, chosen, hidden=False)


def names_on_paper(drawer: LineDrawer, camera: Camera, camera_from_part: Rigid, chosen: Selection | None) -> Picture:
    """Return the same without a photo; of chosen parts all lines are shown, as if they stood alone."""
    paper = np.full((camera.height, camera.width, 3), 0.2, np.float32)
    wires = drawer.draw(camera, camera_from_part, options=LineOptions(hidden=chosen is not None))
    return _named(paper, wires, drawer.scene, chosen, hidden=True)


def _named(under: Picture, wires: Wireframe, scene: Scene, chosen: Selection | None, *, hidden: bool) -> Picture:
    shown = np.ones(len(scene.mesh.part_names), bool) if chosen is None else chosen.bodies(scene)
    drawn = [
        lines.select(shown[lines.part]) for lines in ((wires.hidden, wires.visible) if hidden else (wires.visible,))
    ]
    picture = under
    for lines in drawn:
        for number in np.unique(lines.part):
            mine = [q for q, p in zip(lines.lines, lines.part, strict=True) if p == number]
            picture = draw_polylines(picture, mine, color=PART_COLORS[number % len(PART_COLORS)], width=1.6)
    height = max(11.0, wires.camera.height / 48)
    taken: list[Array] = []
    labels = {
        text: at for lines in drawn for text, at in _labels(lines, wires.camera, scene, chains=chosen is not None)
    }
    for text, at in labels.items():
        q = _free(at, taken, height, len(text), wires.camera)
        taken.append(q)
        for shift in _AROUND:
            picture = draw_text(picture, q + shift, text, color=_HALO, height=height)
        picture = draw_text(picture, q, text, color=(1.0, 1.0, 1.0), height=height)
    return picture


def _labels(lines: Polylines, camera: Camera, scene: Scene, *, chains: bool) -> list[tuple[str, Array]]:
    """Return the texts and their places: the middle of the longest line of each part or chain in the picture."""
    length = lines.length_px
    out = []
    keys = lines.chain if chains else lines.part
    for key in np.unique(keys):
        mine = np.flatnonzero(keys == key)
        if chains and lines.kind[mine[0]] == EdgeKind.CONTOUR:
            continue
        best = mine[np.argmax(length[mine])]
        q = lines.q[lines.start[best] : lines.start[best + 1]]
        q = q[camera.sees(q)]
        if len(q) and length[best] > _LEAST_PX:
            middle = q[0] + 0.5 * (q[-1] - q[0]) if len(q) == 2 else q[len(q) // 2]
            out.append((str(key) if chains else scene.mesh.part_names[int(lines.part[best])], middle))
    return out


def _free(at: Array, taken: list[Array], height: float, letters: int, camera: Camera) -> Array:
    """Return the place nearest below `at`, in the picture, where a label covers none before it."""
    width = _LETTER * height * letters
    q = np.array(
        [np.clip(at[0] + 4, 2, max(camera.width - width - 2, 2)), np.clip(at[1], height, camera.height - height)]
    )
    while any(abs(q[1] - t[1]) < height and abs(q[0] - t[0]) < width for t in taken) and q[1] < camera.height:
        q[1] += height
    return q


def _point(p: Array) -> str:
    return "(" + ", ".join(f"{v:.1f}" for v in p) + ")"


def _short(text: str) -> str:
    return text if len(text) <= 40 else text[:37] + "..."
