"""Models in reports: what a reader sees of them, turns and cuts open, in a real browser."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cadcam.arrays import Array
from cadcam.cad.mesh import Mesh, merge
from cadcam.cad.parts.shape import box
from cadcam.geometry.rigid import Rigid
from cadcam.locate.photo import Photo
from cadcam.plan.coverage import COLORS, Painting, coarser, divided
from cadcam.record.record import Source
from cadcam.render.view import Scene
from cadcam.report.solid import figure as figures
from cadcam.report.solid.figure import CLEAR, WHOLE, LineStyle, Look, Mark, Paint, SolidFigure, solid_script
from cadcam.report.verify.json import VerificationOrigin
from cadcam.report.verify.page import write_verification_page
from cadcam.verify.judge import Verification, verify_part
from cadcam.verify.tolerances.tolerance import whole_parts

from ..verify.scene import POSE, displaced, part, photo
from .browser import driven
from .test_verify_page import at

ORIGIN = VerificationOrigin("plate", (Source("photo", "photo.png", "0" * 64),))
TOPS = {  # the middles of the bodies' upper faces, mm; all are seen from the photo
    "rib 1": (-40.0, -54.0, 52.0),
    "rib 2": (-40.0, 36.0, 52.0),
    "block": (95.0, -40.0, 45.0),
    "bracket": (100.0, 50.0, 40.0),
    "plate": (10.0, 85.0, 12.0),
}
# What is said at places q of the canvas (shares of its height off its middle), and of what dragging and the wheel do.
DRIVER = """
f.onload = () => {
  const inside = (text) => f.contentWindow.eval(text), solid = inside("solids[0]"), canvas = solid.canvas;
  const rect = canvas.getBoundingClientRect();
  const said = ([x, y]) => {
    solid.pointer = [rect.width / 2 + x * rect.height, rect.height / 2 + y * rect.height];
    const face = solid.under("face", 0);
    return face < 0 ? "" : [solid.model.said[solid.model.part[face]], solid.words[solid.paint[face]] || ""].join("|");
  };
  const fire = (kind, type, more) => {
    const where = { clientX: rect.left + 50, clientY: rect.top + 50, ...more };
    const at = { bubbles: true, cancelable: true, pointerId: 1, ...where };
    return canvas.dispatchEvent(new (inside(kind))(type, at));
  };
  const out = { said: q.map(said) };
  solid.cut = solid.placed(new Float32Array(deeper))[2] / solid.frame[0];
  solid.draw();
  out.cut = q.map(said);
  out.scrolled = fire("WheelEvent", "wheel", { deltaY: 100 });
  out.zoom = [solid.zoom];
  fire("PointerEvent", "pointerdown");
  fire("PointerEvent", "pointerup");
  out.held = !fire("WheelEvent", "wheel", { deltaY: 100 });
  out.zoom.push(solid.zoom);
  fire("PointerEvent", "pointerdown");
  fire("PointerEvent", "pointermove", { clientX: rect.left + 150 });
  fire("PointerEvent", "pointerup", { clientX: rect.left + 150 });
  out.turn = solid.turn;
  const select = f.contentDocument.querySelector("select");
  if (select) { select.selectedIndex = 1; select.onchange(); inside("solids[0]").look(told); out.chosen = q.map(said); }
  document.body.dataset.out = JSON.stringify(out);
};
"""


def drive(page: Path, q: Array, *, deeper: Array) -> dict[str, Any]:
    """Return what the driver saw; q (n, 2): places; deeper (3,): a point, in radii, up to which the body is cut off."""
    numbers = {"q": np.asarray(q).tolist(), "deeper": np.asarray(deeper).tolist(), "told": told(page)["looks"][0]}
    head = "".join(f"const {name} = {json.dumps(value)};" for name, value in numbers.items())
    return dict(json.loads(driven(page, head + DRIVER)["out"]))


def told(page: Path) -> dict[str, Any]:
    found = re.search(r'<script type="application/json">(.*?)</script>', page.read_text(), flags=re.DOTALL)
    assert found is not None
    return dict(json.loads(found[1]))


@pytest.fixture(scope="module")
def found() -> tuple[Verification, Photo]:
    built = displaced("block", None, displaced("rib 1", np.array([0.0, 1.5, 0.0])))
    taken = photo(built, np.random.default_rng(3))
    return verify_part(part(), [taken], at(Rigid(), 1.0), whole_parts(part().scene)), taken


def test_a_verified_model_is_shown_as_in_the_photo_and_tells_what_was_found(
    found: tuple[Verification, Photo], tmp_path: Path
) -> None:
    page = tmp_path / "report.html"
    write_verification_page(page, found[0], [found[1]], ORIGIN, scene=part().scene)
    seen = found[0].inspection
    assert seen is not None
    camera_from_part = POSE @ seen.pose.world_from_part
    look = told(page)["looks"][0]
    low, high = part().scene.mesh.bounds
    radius = float(np.linalg.norm(high - low)) / 2
    q = (camera_from_part @ np.array(list(TOPS.values())))[:, :2] / (look["tall"] * radius)
    shown = drive(page, q, deeper=np.zeros(3))
    state = {f.name: f for f in seen.features}
    rib = f"{state['rib 1'].size:.2f} ± {2 * state['rib 1'].sigma:.2f} mm"
    words = [said.split("|")[0] for said in shown["said"]]
    assert words[0] == f"rib 1: displaced, {rib}"
    assert words[1].startswith("rib 2: in place, ")
    assert words[2].startswith("plate: in place")  # the block is missing: one looks through it
    assert words[3].startswith("bracket: in place, ")
    assert words[4].startswith("plate: in place")
    # lines: those of the missing block are through, those of the displaced rib in a shade of what it is off
    page_told = told(page)
    through = [k for k, style in enumerate(page_told["styles"]) if style["through"]]
    assert len(through) == 1
    marks = {mark["text"].split(":")[0]: mark for mark in page_told["marks"]}
    assert set(marks) == {"rib 1", "block"}
    assert marks["block"]["to"] is None
    along = np.array(marks["rib 1"]["to"]) - np.array(marks["rib 1"]["at"])
    np.testing.assert_allclose(along / np.linalg.norm(along), state["rib 1"].vector / state["rib 1"].size, atol=1e-3)


def test_a_look_is_that_of_a_camera_on_its_axis(tmp_path: Path) -> None:
    """On the axis of a camera a parallel view shows what the camera does: here one face each of three boxes."""
    names, where = ("near", "middle", "far"), (0.0, 40.0, 80.0)
    for k, x in enumerate(where):
        mesh = boxes(names, where)
        page = tmp_path / f"{k}.html"
        eye, middle = np.array([x + 3.0, -200.0, 90.0]), np.array([x + 3.0, 4.0, 15.0])
        looks = [Look("camera", Rigid.look_at(eye, middle), 60.0, cut=True), WHOLE]
        page.write_text(plain(mesh, looks))
        shown = drive(page, np.zeros((1, 2)), deeper=np.zeros(3))
        assert shown["said"] == [f"{names[k]}|"]


def boxes(names: tuple[str, ...], where: tuple[float, ...]) -> Mesh:
    return merge([box((x, 0, 0), (x + 20, 20, 20), name=name) for name, x in zip(names, where, strict=True)])


def plain(mesh: Mesh, looks: list[Look], marks: tuple[Mark, ...] = ()) -> str:
    edges = Scene.of(mesh).edges.vertices
    paints = [
        Paint("one", np.zeros(mesh.n_faces, np.int64)),
        Paint("by part", 1 + mesh.part.astype(np.int64), ["", "red", "green", "blue"]),
    ]
    colors = ["#cccccc", "#cc0000", "#00cc00", "#0000cc"]
    figure = SolidFigure(
        mesh,
        mesh.part_names,
        colors,
        paints,
        mesh.vertices[edges],
        [LineStyle()],
        np.zeros(len(edges), np.int64),
        looks,
        marks,
    )
    return f"<body style='margin:0'>{figure.html('boxes')}{solid_script()}</body>"


def test_it_is_cut_open_turned_zoomed_and_painted_otherwise(tmp_path: Path) -> None:
    mesh = boxes(("a", "b", "c"), (0.0, 40.0, 80.0))
    low, high = mesh.bounds
    middle, radius = (low + high) / 2, float(np.linalg.norm(high - low)) / 2
    front = Rigid.look_at(middle - np.array([0.0, 500.0, 0.0]), middle)
    page = tmp_path / "page.html"
    page.write_text(plain(mesh, [Look("front", front, 60.0), WHOLE]))
    q = (front @ np.array([[10.0, 0, 10], [50.0, 0, 10], [90.0, 0, 10], [30.0, 0, 10]]))[:, :2] / 60.0
    look = told(page)["looks"][0]
    shown = drive(page, q, deeper=np.array([0.0, 0.99 * 10 / radius, 0.0]))
    assert shown["said"] == ["a|", "b|", "c|", ""]
    assert shown["cut"] == ["a|", "b|", "c|", ""]  # their fronts are cut away, and their backs show from inside
    assert shown["scrolled"] is True  # a page that is scrolled is not held up by a figure on the way
    assert shown["held"] is True
    before, after = shown["zoom"]
    assert before == pytest.approx(told_zoom(look), rel=1e-9)
    assert after == pytest.approx(before * np.exp(-0.15), rel=1e-9)
    about = np.array([[np.cos(0.8), 0, -np.sin(0.8)], [0, 1, 0], [np.sin(0.8), 0, np.cos(0.8)]])  # 100 px to the right
    turn = np.reshape(shown["turn"], (3, 3))
    np.testing.assert_allclose(turn @ np.reshape(look["turn"], (3, 3)).T, about.T, atol=1e-4)
    assert shown["chosen"] == ["a|red", "b|green", "c|blue", ""]


def told_zoom(look: dict[str, float]) -> float:
    """Return the zoom of a look in the driver's frame of 1200 px: the canvas is 300 x 150 px without a style."""
    return 150 / look["tall"] / (0.46 * 150)


def test_names_do_not_end_the_script_and_large_models_show_lines_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    mesh = replace(boxes(("a", "b", "c"), (0.0, 40.0, 80.0)), part_names=("</script><b>", "b", "c"))
    marks = (Mark(np.zeros(3), "</script><i>"),)
    page = tmp_path / "page.html"
    page.write_text(plain(mesh, [WHOLE], marks))
    assert "<b>" not in page.read_text()
    assert "<i>" not in page.read_text()
    assert told(page)["said"][0] == "</script><b>"
    assert told(page)["faces"] != ""
    monkeypatch.setattr(figures, "_MOST", mesh.n_faces - 1)
    page.write_text(plain(mesh, [WHOLE], marks))
    assert told(page)["faces"] == ""
    assert told(page)["edges"] != ""
    assert drive(page, np.zeros((1, 2)), deeper=np.zeros(3))["said"] == [""]


def test_what_is_not_filled_hides_nothing(tmp_path: Path) -> None:
    mesh = boxes(("a", "b", "c"), (0.0, 40.0, 80.0))
    paint = Paint("without b", np.where(mesh.part == 1, CLEAR, 0))
    side = Rigid.look_at(np.array([-500.0, 10, 10]), np.array([0.0, 10, 10]))  # c behind b behind a
    none = np.zeros((0, 2, 3)), [LineStyle()], np.zeros(0, np.int64)
    page = tmp_path / "page.html"
    figure = SolidFigure(mesh, mesh.part_names, ["#cccccc"], [paint], *none, [Look("side", side)])
    page.write_text(figure.html("boxes") + solid_script())
    shown = drive(page, np.zeros((1, 2)), deeper=np.zeros(3))
    assert shown["said"] == ["a|"]
    low, high = mesh.bounds
    beyond = np.array([-0.2 * np.linalg.norm(high - low) / 2, 0, 0]) / (np.linalg.norm(high - low) / 2)
    assert drive(page, np.zeros((1, 2)), deeper=beyond)["cut"] == ["c|"]


def test_a_coarser_painting_has_the_same_colours_where_they_are() -> None:
    part = box((0, 0, 0), (300, 200, 40), name="part")
    fine = divided(part)
    right = fine.vertices[fine.faces].mean(axis=1)[:, 0] > 150
    up = fine.face_normals[:, 2] > 0.5
    painting = Painting("halves", fine, right.astype(np.int64) + 2 * up, COLORS, ("",) * len(COLORS))
    few = coarser(painting, part, 1000)
    assert 300 < few.mesh.n_faces < 2500 < fine.n_faces
    middle = few.mesh.vertices[few.mesh.faces].mean(axis=1)
    clear = np.abs(middle[:, 0] - 150) > 0.03 * np.linalg.norm(part.size_mm)  # a piece's size off the border
    wanted = (middle[:, 0] > 150).astype(np.int64) + 2 * (few.mesh.face_normals[:, 2] > 0.5)
    np.testing.assert_array_equal(few.level[clear], wanted[clear])
    np.testing.assert_allclose(few.shares[:4], painting.shares[:4], atol=0.05)
