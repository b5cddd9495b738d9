"""Lines of parts moved as wholes, drawn with what stays of a drawing before: those that a drawing anew gives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from cadcam.arrays import Array
from cadcam.cad.mesh import Mesh
from cadcam.cad.parts import ship_block
from cadcam.camera.camera import Camera
from cadcam.geometry.rigid import Rigid
from cadcam.native.rays import NativeRays
from cadcam.render import caster
from cadcam.render.lines import moved as moved_faces
from cadcam.render.lines.moved import MovedFaces, _crossing
from cadcam.render.lines.visible import LineDrawer
from cadcam.render.lines.wireframe import LineOptions, Wireframe
from cadcam.render.view import Scene

from .scenes import views_of

BOTH = LineOptions(hidden=True, margin_px=0)
CAMERA = Camera.from_focal((640, 480), 700.0)
INNER = ("bracket 2.1 port", "bar 1.1 port", "longitudinal 1 port")
BLOCK = ship_block(triangles=8_000)
STILL = LineDrawer(Scene.of(BLOCK))


def moved(mesh: Mesh, by: dict[str, Sequence[float]]) -> Mesh:
    vertices = mesh.vertices.copy()
    for name, shift in by.items():
        vertices[np.unique(mesh.faces[mesh.part == mesh.part_names.index(name)])] += shift
    return replace(mesh, vertices=vertices)


def drawn(drawer: LineDrawer) -> list[Wireframe]:
    return [drawer.draw(CAMERA, pose, options=BOTH) for pose in views_of(BLOCK)]


def bits(wireframes: Sequence[Wireframe]) -> list[bytes]:
    lines = [each for w in wireframes for each in (w.visible, w.hidden)]
    return [a.tobytes() for one in lines for a in (one.q, one.p, one.start, one.kind, one.part, one.chain)]


def scene_with(by: dict[str, Sequence[float]]) -> Scene:
    return replace(STILL.scene, mesh=moved(BLOCK, by))


@pytest.mark.parametrize("rays", ["embree", "core"])
@pytest.mark.parametrize(
    "by",
    [
        {INNER[0]: (4.0, -3.0, 2.0)},
        {INNER[1]: (0.0, 60.0, 40.0)},
        {"floor 2 port": (150.0, 0.0, 0.0)},  # through its neighbours, and before them
        {INNER[0]: (-9.0, 5.0, 0.0), INNER[1]: (12.0, 0.0, 7.0), INNER[2]: (0.0, 0.0, 15.0)},
        {},
        {"tank top": (0.0, 0.0, 300.0)},  # beyond the box around the whole: drawn anew
    ],
)
def test_lines_are_those_of_a_drawing_anew_bit_by_bit(
    by: dict[str, Sequence[float]], rays: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    if rays == "core":
        monkeypatch.setattr(caster, "_rays", NativeRays)
    else:
        pytest.importorskip("embreex", reason="Embree has no wheels here")
    still, scene = LineDrawer(STILL.scene), scene_with(by)
    assert bits(drawn(LineDrawer(scene, like=still))) == bits(drawn(LineDrawer(scene)))


def test_what_was_moved_before_may_be_moved_again() -> None:
    once = scene_with({INNER[1]: (5.0, 8.0, 0.0)})
    twice = scene_with({INNER[1]: (0.0, 0.0, 9.0), INNER[0]: (4.0, 0.0, 4.0)})
    again = LineDrawer(twice, like=LineDrawer(once, like=STILL))
    assert isinstance(again._occluders, MovedFaces)
    assert bits(drawn(again)) == bits(drawn(LineDrawer(twice)))


def test_only_the_parts_near_those_moved_are_cast_at(monkeypatch: pytest.MonkeyPatch) -> None:
    """A sight that passes by the moved part is answered by the tree that there is."""
    faces: list[int] = []

    class Counted(caster.Caster):
        def __init__(self, mesh: Mesh, *, center: Array | None = None) -> None:
            faces.append(mesh.n_faces)
            super().__init__(mesh, center=center)

    monkeypatch.setattr(moved_faces, "Caster", Counted)
    drawn(LineDrawer(scene_with({INNER[0]: (4.0, -3.0, 2.0)}), like=STILL))
    assert faces
    assert max(faces) < BLOCK.n_faces / 2


def test_sights_near_moved_parts_have_to_be_cast_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    """Negative control: asked of the faces as they were, some lines are hidden that are seen, or seen that are not."""
    scene = scene_with({"floor 2 port": (150.0, 0.0, 0.0)})
    monkeypatch.setattr(MovedFaces, "_concerned", lambda self, a, b: np.zeros(len(a), bool))
    assert bits(drawn(LineDrawer(scene, like=STILL))) != bits(drawn(LineDrawer(scene)))


def test_which_segments_meet_a_box(rng: np.random.Generator) -> None:
    """As points along them say, 1/500 of each apart: those that only touch a corner between two points are left out."""
    low, high = np.array([-1.0, -0.5, 0.2]), np.array([0.6, 0.7, 0.9])
    a, b = rng.uniform(-2, 2, size=(2, 4000, 3))
    a[:600, 0] = b[:600, 0]  # across an axis, and along one
    a[:200, :2] = b[:200, :2]
    t = np.linspace(0, 1, 501)[:, None, None]
    p = a + t * (b - a)
    inside = ((p >= low) & (p <= high)).all(axis=2).any(axis=0)
    wider = ((p >= low - 0.02) & (p <= high + 0.02)).all(axis=2).any(axis=0)  # points are 4 sqrt(3)/500 apart at most
    met = np.zeros(4000, bool)
    met[_crossing(a, b, low, high)] = True
    assert inside.sum() > 300
    assert not (inside & ~met).any()
    assert not (met & ~wider).any()


def test_a_moved_part_is_where_it_is_for_an_eye_inside_its_old_box() -> None:
    """The box by which a solid is told not to hold the eye moves along with it."""
    name = INNER[1]
    place = BLOCK.subset([name]).bounds.mean(axis=0)
    scene, pose = scene_with({name: (0.0, 60.0, 40.0)}), Rigid.look_at(place, place + np.array([100.0, 400.0, -50.0]))
    one, other = (d.draw(CAMERA, pose, options=BOTH) for d in (LineDrawer(scene, like=STILL), LineDrawer(scene)))
    assert bits([one]) == bits([other])
