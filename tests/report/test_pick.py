"""The page for picking corners: what it offers, and that clicks become a points file that calibrates the camera."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

from cadcam.cad.corners import corner_vertices
from cadcam.cad.mesh import merge
from cadcam.cad.parts.shape import box
from cadcam.cad.rims import rim_centers
from cadcam.calibrate.points.camera import calibrate_camera
from cadcam.camera.camera import Camera
from cadcam.camera.observations import Observations
from cadcam.errors import BadValue
from cadcam.files.points import read_points
from cadcam.geometry.rigid import Rigid
from cadcam.render import open_renderer
from cadcam.render.view import Scene
from cadcam.report.pick.page import write_pick_page

from .browser import driven

MODELS = Path(__file__).resolve().parents[2] / "models"
CAMERA = Camera.from_focal((640, 480), 700.0, fy=720.0, cx=310.0, cy=250.0)
POSE = Rigid.look_at(np.array([500.0, -600.0, 450.0]), np.array([120.0, 80.0, 50.0]))


def stairs() -> Scene:
    """Return a step on a slab: 16 corners, most of which are seen from the page's first view."""
    slab, step = box((0, 0, 0), (300, 200, 40), name="slab"), box((80, 50, 40), (200, 150, 140), name="step")
    return Scene.of(merge([slab, step]))


def told(page: Path) -> dict[str, object]:
    found = re.search(r'<script type="application/json" id="told">(.*?)</script>', page.read_text(), flags=re.DOTALL)
    assert found is not None
    return dict(json.loads(found[1]))


def photo() -> np.ndarray:
    return np.asarray(open_renderer(stairs(), threads=1).render(CAMERA, POSE).image)


def test_corners_are_where_edges_meet() -> None:
    scene = stairs()
    assert {tuple(p) for p in corner_vertices(scene.mesh, scene.edges).tolist()} == {
        (x, y, z) for xs, ys, zs in (((0, 300), (0, 200), (0, 40)), ((80, 200), (50, 150), (40, 140)))
        for x in xs for y in ys for z in zs
    }  # fmt: skip


def test_rims_of_holes_have_middles_and_no_corners() -> None:
    from cadcam.cad.read import read_model

    scene = Scene.of(read_model(MODELS / "bracket.stl"))
    middles = rim_centers(scene.mesh, scene.edges)
    drawn = {(104.0, 16.0), (104.0, 64.0), (52.0, 64.0), (52.0, 16.0)}  # the plate's four holes, above and below
    assert drawn <= {(round(x, 3), round(y, 3)) for x, y, _ in middles.tolist()}
    assert len(corner_vertices(scene.mesh, scene.edges)) < 10


def test_points_that_were_picked_before_are_kept(tmp_path: Path) -> None:
    scene = stairs()
    seen = np.array([[0.0, 0, 40], [12.5, 3, 4]])  # a corner, and a point that is none
    before = Observations(seen, CAMERA.project(POSE @ seen), ("C2", ""))
    assert write_pick_page(tmp_path / "pick.html", photo(), scene, picked=before) == 17
    page = told(tmp_path / "pick.html")
    names, corners, picked = page["names"], page["corners"], page["picked"]
    assert [names[k] for k, *_ in picked] == ["C2", "P18"]
    assert len(set(names)) == 17  # no other corner is called C2
    np.testing.assert_array_equal([corners[k] for k, *_ in picked], seen)
    np.testing.assert_array_equal([q for _, *q in picked], before.q)


def test_a_point_outside_of_the_photo_is_refused(tmp_path: Path) -> None:
    outside = Observations(np.zeros((1, 3)), np.array([[640.0, 20.0]]), ("far",))
    with pytest.raises(BadValue, match=r"point 'far' is \[640.0, 20.0\]; expected within the photo, 640 x 480 px"):
        write_pick_page(tmp_path / "pick.html", photo(), stairs(), picked=outside)
    assert not (tmp_path / "pick.html").exists()


def test_names_do_not_end_the_script(tmp_path: Path) -> None:
    p = np.array([[0.0, 0, 40]])
    before = Observations(p, CAMERA.project(POSE @ p), ("</script><b>",))
    write_pick_page(tmp_path / "pick.html", photo(), stairs(), picked=before, names=("<i>.png", "a&b.stl"))
    text = (tmp_path / "pick.html").read_text()
    assert "<i>.png" not in text
    assert "<b>" not in text
    assert "</script><b>" in told(tmp_path / "pick.html")["names"]


# Click each corner that the first view shows, then its place in the photo; then open the page once more.
DRIVER = """
const inside = (text) => f.contentWindow.eval(text);
const click = (canvas, x, y) => {
  const rect = canvas.getBoundingClientRect();
  const at = { clientX: rect.left + x, clientY: rect.top + y, bubbles: true, pointerId: 1 };
  for (const type of ["pointerdown", "pointerup"]) canvas.dispatchEvent(new (inside("PointerEvent"))(type, at));
};
const drag = (canvas, [x, y], [dx, dy]) => {
  const rect = canvas.getBoundingClientRect();
  [["pointerdown", 0], ["pointermove", 0.5], ["pointermove", 1], ["pointerup", 1]].forEach(([type, t]) => {
    const at = { clientX: rect.left + x + t * dx, clientY: rect.top + y + t * dy, bubbles: true, pointerId: 1 };
    canvas.dispatchEvent(new (inside("PointerEvent"))(type, at));
  });
};
const picked = () => {
  truth.forEach((q, k) => {
    if (!inside(`model.visible[${k}]`)) return;
    const [x, y] = [0, 1].map((c) => inside(`model.places[${3 * k + c}]`));
    click(f.contentDocument.getElementById("model"), x, y);
    if (k !== inside("active")) throw new Error(`clicked ${k}, chose ${inside("active")}`);
    click(f.contentDocument.getElementById("photo"), ...inside(`photo.place(${q})`));
  });
  for (const key of ["ArrowRight", "ArrowLeft"]) {
    f.contentDocument.dispatchEvent(new (inside("KeyboardEvent"))("keydown", { key, bubbles: true }));
  }
  // the photo's own borders lie half a pixel beyond the centres of its outer pixels
  const borders = inside("[...photo.place(-0.5, -0.5), ...photo.shift, ...photo.place(639.5, 479.5)]");
  const said = { borders, scale: inside("photo.scale"), rms: inside("fitted.rms"), csv: inside("csv()") };
  Object.assign(document.body.dataset, said, { status: inside("element('status').textContent") });
  drag(f.contentDocument.getElementById("photo"), inside("photo.place(...picks.get(active))"), [8, -4]);
  document.body.dataset.dragged = inside("csv()");
  drag(f.contentDocument.getElementById("photo"), inside("photo.place(...picks.get(active))"), [-8, 4]);
  const again = document.createElement("iframe"); // the page opened once more: this one's load event waits for it
  again.src = "pick.html";
  again.onload = () => { document.body.dataset.again = again.contentWindow.eval("csv()"); };
  document.body.append(again);
};
f.onload = picked;
"""


def test_clicks_become_points_that_calibrate_the_camera(tmp_path: Path) -> None:
    scene = stairs()
    write_pick_page(tmp_path / "pick.html", photo(), scene, names=("photo.png", "stairs.stl"))
    corners = np.array(told(tmp_path / "pick.html")["corners"])
    truth = CAMERA.project(POSE @ corners)
    said = driven(tmp_path / "pick.html", f"const truth = {json.dumps(truth.tolist())};{DRIVER}")
    (tmp_path / "points.csv").write_text(said["csv"])
    points = read_points(tmp_path / "points.csv")
    which = [int(np.argmin(np.linalg.norm(corners - p, axis=1))) for p in points.p_world]
    np.testing.assert_array_equal(points.p_world, corners[which])
    assert len(which) >= 10
    assert np.abs(points.q - truth[which]).max() <= 0.005 + 1e-6  # two decimals are written
    assert float(said["rms"]) < 0.01 / np.sqrt(6)  # what rounding to hundredths makes of two coordinates
    assert said["status"].startswith(f"{points.names[-1]}: drag it")
    moved = np.array([float(v) for v in said["dragged"].split()[-1].split(",")[-2:]]) - points.q[-1]
    np.testing.assert_allclose(
        moved, np.array([8, -4]) / float(said["scale"]), atol=0.01 + 1e-9
    )  # two steps, each rounded to hundredths
    assert said["again"] == said["csv"]
    left, top, x, y, right, bottom = map(float, said["borders"].split(","))
    assert (left, top) == (x, y)
    np.testing.assert_allclose([right - x, bottom - y], float(said["scale"]) * np.array(CAMERA.size), rtol=1e-12)
    estimate = calibrate_camera(points, size=CAMERA.size)
    assert abs(estimate.camera.fy - CAMERA.fy) < 5 * estimate.sigma("focal")
