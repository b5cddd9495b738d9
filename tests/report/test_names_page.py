"""The page on which edges are clicked: what it writes is a tolerance file of just these edges."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np

from cadcam.cad.edges import EdgeKind
from cadcam.cad.mesh import merge
from cadcam.cad.parts.shape import box
from cadcam.render.view import Scene
from cadcam.report.verify.names_page import names_page
from cadcam.verify.tolerances.file import read_tolerances
from cadcam.verify.tolerances.tolerance import Selection

from .browser import beyond, driven

NAMES = ('slab "a": 1', "no", "step")  # as YAML has them, they would be a mapping and a truth value

# Click places of the body (mm, as radii about its middle); tell what the pointer is told there, and the entries.
DRIVER = """
f.onload = () => {
  const solid = f.contentWindow.eval("solids[0]"), canvas = solid.canvas;
  const at = (p) => solid.placed(new Float32Array(p)).slice(0, 2).map((v) => v / solid.fine);
  const out = { said: [] };
  const click = (p) => {
    const [x, y] = at(p), rect = canvas.getBoundingClientRect(); // it moves where a scroll bar comes in
    const where = { clientX: rect.left + x, clientY: rect.top + y, bubbles: true, pointerId: 1 };
    for (const type of ["pointermove", "pointerdown", "pointerup"]) {
      canvas.dispatchEvent(new (f.contentWindow.eval("PointerEvent"))(type, where));
      if (type === "pointermove") out.said.push(solid.said());
    }
  };
  const text = () => f.contentDocument.getElementById("entries").textContent;
  out.before = text();
  clicked.forEach(click);
  out.entries = text();
  out.styles = [...solid.model.style];
  click(clicked[0]);
  out.fewer = text();
  f.contentDocument.getElementById("none").click();
  out.after = text();
  document.body.dataset.out = JSON.stringify(out);
};
"""


def scene() -> Scene:
    boxes = [
        box((0, 0, 0), (300, 200, 40), name="a"),
        box((330, 0, 0), (400, 200, 90), name="b"),
        box((80, 50, 40), (200, 150, 140), name="c"),
    ]
    return Scene.of(replace(merge(boxes), part_names=NAMES))


def test_what_is_clicked_is_a_tolerance_file_of_these_edges(tmp_path: Path) -> None:
    part = scene()
    low, high = part.mesh.bounds
    middle, radius = (low + high) / 2, float(np.linalg.norm(high - low)) / 2
    clicked = np.array(
        [
            [50.0, 0.0, 40.0],  # an upper edge of the slab, in front
            [365.0, 100.0, 90.0],  # the top of the second box
            [140.0, 50.0, 140.0],  # an upper edge of the step
            [80.0, 50.0, 100.0],  # an upright edge of it
        ]
    )
    page = tmp_path / "names.html"
    page.write_text(names_page(part, "part.stl"))
    radii = ((clicked - middle) / radius).tolist()
    out = json.loads(driven(page, f"const clicked = {json.dumps(radii)};{DRIVER}")["out"])
    chains = [chain_at(part, clicked[k]) for k in (0, 2, 3)]
    kind = EdgeKind(int(part.edges.kind[part.edges.chain == chains[0]][0])).name.lower()
    length = part.edges.lengths(part.mesh)[part.edges.chain == chains[0]].sum()
    assert out["said"][0] == f"{NAMES[0]}: chain {chains[0]}, {kind}, {length:.1f} mm"
    assert out["said"][1] == NAMES[1]
    assert out["before"] == out["after"] == "Click edges, or bodies."
    (tmp_path / "tolerances.yaml").write_text(out["entries"])
    features = {f.name: f for f in read_tolerances(tmp_path / "tolerances.yaml").features}
    assert set(features) == set(NAMES)
    assert features[NAMES[0]].selection.chains == (chains[0],)
    assert features[NAMES[1]].selection.whole
    assert features[NAMES[2]].selection.chains == tuple(sorted(chains[1:]))
    for name, feature in features.items():
        assert feature.selection.part == name
        assert feature.limits
    shown = np.isin(part.edges.chain, chains)
    np.testing.assert_array_equal(np.array(out["styles"]) == 1, shown)
    (tmp_path / "tolerances.yaml").write_text(out["fewer"])
    assert [f.name for f in read_tolerances(tmp_path / "tolerances.yaml").features] == [NAMES[1], NAMES[2]]


def chain_at(part: Scene, p: np.ndarray) -> int:
    """Return the chain of the edge that passes through a point."""
    a, b = np.moveaxis(part.mesh.vertices[part.edges.vertices], 1, 0)
    t = np.clip(np.sum((p - a) * (b - a), axis=1) / np.sum((b - a) ** 2, axis=1), 0, 1)
    return int(part.edges.chain[np.argmin(np.linalg.norm(a + t[:, None] * (b - a) - p, axis=1))])


def test_of_chosen_bodies_alone_the_others_are_not_shown(tmp_path: Path) -> None:
    page = tmp_path / "names.html"
    page.write_text(names_page(scene(), "part.stl", Selection("step")))
    seen = "f.onload = () => { const s = f.contentWindow.eval('solids[0]'); const all = new Set(s.sheet.face);"
    seen += "document.body.dataset.out = JSON.stringify([...all].filter((k) => k >= 0).map((k) => s.model.part[k])); };"
    assert set(json.loads(driven(page, seen)["out"])) == {2}
    assert [beyond(page, width) for width in (1280, 390)] == [[0], [0]]
