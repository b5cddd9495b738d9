"""All renderers see the same faces of the same models through the same cameras: those that brute force finds.

Each is held to a double-precision reference within its own bound, far below the half pixel around edges within which
two of them may differ; so they agree with each other. gl is skipped where OpenGL does not answer on EGL (Debian:
libegl1, libgl1-mesa-dri), raster where the compiled core is missing.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from cadcam.cad.mesh import Mesh, merge
from cadcam.cad.parts import calibration_bench, machined_bracket, ship_block
from cadcam.cad.read import read_model
from cadcam.camera.camera import Camera
from cadcam.camera.lens import BrownConrady, Fisheye
from cadcam.errors import MissingCore, MissingExtra, MissingOpenGL
from cadcam.geometry.rigid import Rigid
from cadcam.render import RENDERERS, open_renderer
from cadcam.render.ray import RayRenderer
from cadcam.render.view import Look, Renderer, Scene, View

from .agreement import FLOAT, Bound, Truth, bound_of, check
from .coverage import brute_force
from .scenes import scene_of

SMALL, LARGE = (160, 120), (1000, 750)
CAMERAS = {  # of 400 x 300 px; strongly distorted: corners move by 90 px, and the fisheye's lie beyond its 90 degrees
    "plain": Camera.from_focal((400, 300), 420.0),
    "skewed": Camera.from_focal((400, 300), 410.0, fy=456.0, cx=171.3, cy=177.8, skew=28.0),
    "Brown-Conrady": Camera.from_focal(
        (400, 300), 310.0, fy=302.0, cx=189.2, cy=158.9, lens=BrownConrady(-0.28, 0.06, 2e-3)
    ),
    "fisheye": Camera.from_focal((400, 300), 120.0, cx=207.4, cy=141.1, lens=Fisheye(k1=-0.02)),
}
PARTS = {
    "bracket": machined_bracket,
    "bench": calibration_bench,
    "block": lambda: ship_block(triangles=8_000),
}
STEP = ("nist_ctc_01_asme1_ap242", "nist_ctc_03_asme1_ap242", "nist_ctc_05_asme1_ap242")
WIDEST = Bound(2 / 256, 4 * FLOAT, 1e-5)


def views_of(mesh: Mesh) -> list[Rigid]:
    """From outside, and from inside, where faces pass the camera's plane."""
    low, high = mesh.bounds
    middle, size = (low + high) / 2, high - low
    return [
        Rigid.look_at(middle + size * [0.9, 0.75, 1.05], middle),
        Rigid.look_at(middle + size * [0.2, 0.1, 0.05], middle - size * [0.3, 0.4, 0.1]),
    ]


def opened(scene: Scene, name: str) -> Renderer:
    try:
        return open_renderer(scene, name)
    except (MissingCore, MissingExtra, MissingOpenGL) as error:
        pytest.skip(str(error))


@pytest.fixture(
    scope="module", params=[*PARTS, STEP[0], *(pytest.param(name, marks=pytest.mark.slow) for name in STEP[1:])]
)
def scene(request: pytest.FixtureRequest, shared: Callable[[str], Path]) -> Scene:
    if request.param in PARTS:
        return scene_of(PARTS[request.param]())
    pytest.importorskip("cascadio", reason="STEP needs the extra step")
    return scene_of(read_model(shared(f"data/cad_nist_ctc/{request.param}.stp")))


@pytest.fixture(scope="module")
def truths(scene: Scene) -> Callable[[Camera], list[Truth]]:
    return cache(lambda camera: [Truth.of(scene, camera, pose) for pose in views_of(scene.mesh)])


@pytest.fixture(scope="module", params=RENDERERS)
def renderer(request: pytest.FixtureRequest, scene: Scene) -> Renderer:
    return opened(scene, request.param)


@pytest.fixture(scope="module")
def bracket() -> Scene:
    return scene_of(machined_bracket())


@pytest.fixture(scope="module")
def bracket_truths(bracket: Scene) -> Callable[[Camera], list[Truth]]:
    return cache(lambda camera: [Truth.of(bracket, camera, pose) for pose in views_of(bracket.mesh)])


@pytest.mark.parametrize("name", CAMERAS)
def test_each_pixel_centre_sees_what_brute_force_sees(
    name: str, renderer: Renderer, truths: Callable[[Camera], list[Truth]]
) -> None:
    camera = small(name)
    for truth in truths(camera):
        view = renderer.render(camera, truth.pose)
        check(view, truth, bound_of(renderer.name, truth))
        if renderer.name == "raster":
            assert np.array_equal(view.coverage, truth.face >= 0), "no tolerance"


@cache
def small(name: str) -> Camera:
    return CAMERAS[name].resize(SMALL)


@pytest.mark.slow
@pytest.mark.parametrize("name", CAMERAS)
def test_each_pixel_centre_of_large_pictures_sees_what_brute_force_sees(name: str, scene: Scene) -> None:
    camera = CAMERAS[name].resize(LARGE)
    for pose in views_of(scene.mesh):
        truth = Truth.of(scene, camera, pose)
        for kind in RENDERERS:
            renderer = opened(scene, kind)
            differ = check(renderer.render(camera, pose), truth, bound_of(kind, truth))
            print(f"{len(scene.mesh.faces):6} faces, {name:13} {kind:6} {differ} pixels see another face")


@pytest.mark.parametrize("name", [pytest.param("plain", marks=pytest.mark.slow), "skewed"])
@pytest.mark.parametrize("kind", RENDERERS)
def test_smooth_coverage_is_the_share_of_samples_that_brute_force_finds(kind: str, name: str, bracket: Scene) -> None:
    """raster without a tolerance; for the others few samples lie so close to an outline."""
    camera, pose, n = small(name), views_of(bracket.mesh)[0], 3
    view = opened(bracket, kind).render(camera, pose, look=Look(supersampling=n))
    fine = camera.resize((n * camera.width, n * camera.height))
    face, _, _ = brute_force(bracket.mesh.vertices, bracket.mesh.faces, fine, pose, number=np.float64)
    share = (face >= 0).reshape(camera.height, n, camera.width, n).mean(axis=(1, 3))
    assert np.mean(np.abs(view.coverage - share) > 1e-6) <= (0 if kind == "raster" else 1e-3)
    assert 0 < np.mean((share > 0) & (share < 1)) < 0.1


@pytest.mark.parametrize("kind", RENDERERS)
def test_a_pixel_at_the_rim_of_a_lens_has_samples_if_its_centre_sees(kind: str) -> None:
    """From within a box all is seen up to the rim, each sample of a pixel by itself; a ring along it was background."""
    fisheye = Camera.from_focal((90, 70), 15.0, cx=43.7, lens=Fisheye())
    corners = np.indices((2, 2, 2)).reshape(3, -1).T * 5 - (1.0, 2.0, 3.0)
    box = Mesh.single(corners, ConvexHull(corners).simplices)
    view = opened(scene_of(box), kind).render(fisheye, Rigid(), look=Look(supersampling=3))
    assert 0.1 < view.mask.mean() < 0.5
    assert view.coverage[view.mask].min() > 0
    assert view.coverage[~view.mask].max() < 1
    if kind != "gl":  # which projects vertices, and cuts a lens' rim along chords
        y, x = np.mgrid[:70, :90]
        x, y = (a - c for a, c in zip((x, y), fisheye.principal_point, strict=True))
        thirds = [(i / 3, j / 3) for i in (-1, 0, 1) for j in (-1, 0, 1)]
        inside = 15.0 * np.pi / 2 - np.stack([np.hypot(x + i, y + j) for i, j in thirds])  # px from the rim
        clear = view.mask & (np.abs(inside).min(axis=0) > 0.01)  # samples lie where they should to thousandths of a px
        assert clear.sum() > 0.98 * view.mask.sum()
        assert np.abs(view.coverage - (inside > 0).mean(axis=0))[clear].max() < FLOAT


@pytest.mark.parametrize("name", CAMERAS)
@pytest.mark.parametrize("kind", RENDERERS)
def test_of_faces_that_coincide_one_is_seen_at_their_depth(kind: str, name: str, bracket: Scene) -> None:
    """Every face twice: whichever is seen, depth and outline are theirs; raster takes the lower number."""
    twice, n = scene_of(merge([bracket.mesh, bracket.mesh])), bracket.mesh.n_faces
    camera, pose = small(name), views_of(bracket.mesh)[0]
    one, two = (opened(scene, kind).render(camera, pose) for scene in (bracket, twice))
    assert np.mean(one.face != np.where(two.face < 0, -1, two.face % n)) <= (1e-3 if kind == "gl" else 0)
    same = (one.face == two.face % n) & (one.face >= 0)
    assert np.abs(one.depth[same] / two.depth[same] - 1).max() < FLOAT
    assert kind != "raster" or two.face.max() < n


def planted() -> Iterator[tuple[str, str, Callable[[Camera], Camera], Callable[[View], dict[str, np.ndarray]]]]:
    """Mistakes, each with the camera that would show it: in the camera drawn with, or in the layers."""

    def moved(x: float, y: float) -> Callable[[Camera], Camera]:
        return lambda c: Camera(c.size, c.K + np.array([[0, 0, x], [0, 0, y], [0, 0, 0]]), c.lens)

    def same(camera: Camera) -> Camera:
        return camera

    def unchanged(view: View) -> dict[str, np.ndarray]:
        return {}

    for name in CAMERAS:
        for x, y in ((0.5, 0.0), (0.0, -0.5), (0.03, 0.03)):
            yield f"{name}: {x}, {y} px off", name, moved(x, y), unchanged
        yield f"{name}: depth 1e-4 too large", name, same, lambda v: {"depth": v.depth * np.float32(1.0001)}
        yield f"{name}: depth along the ray", name, same, lambda v: {"depth": along_the_ray(v)}
        yield f"{name}: the next face of a plane", name, same, lambda v: {"face": swapped(v.face)}
        yield f"{name}: a pixel missing", name, same, without_a_pixel
    flipped = np.array([[1, -1, 1], [1, 1, 1], [1, 1, 1]])
    yield "skew of the other sign", "skewed", lambda c: Camera(c.size, c.K * flipped, c.lens), unchanged
    for name in ("Brown-Conrady", "fisheye"):
        yield f"{name}: no lens", name, lambda c: Camera(c.size, c.K), unchanged
    weak = BrownConrady(-0.2795, 0.06, 2e-3)
    yield "a lens a little weaker", "Brown-Conrady", lambda c: Camera(c.size, c.K, weak), unchanged


def along_the_ray(view: View) -> np.ndarray:
    ray = view.camera.unproject(view.camera.pixel_grid())
    return np.asarray(view.depth / np.where(np.isfinite(ray[..., 2]), ray[..., 2], 1), np.float32)


def swapped(face: np.ndarray) -> np.ndarray:
    """Every face numbered as its neighbour, which lies in the same plane for most."""
    return np.where(face >= 0, face ^ 1, -1).astype(np.int32)


def without_a_pixel(view: View) -> dict[str, np.ndarray]:
    """The view with a hole of one pixel in its middle, in every layer."""
    y, x = np.argwhere(view.face >= 0)[np.count_nonzero(view.face >= 0) // 2]
    layers = {name: layer.copy() for name, layer in view.layers.items()}
    for name, layer in layers.items():
        layer[y, x] = {"face": -1, "part": -1, "depth": np.inf, "image": 1}.get(name, 0)
    return layers


@pytest.mark.parametrize(("name", "drawn_with", "layers"), [p[1:] for p in planted()], ids=[p[0] for p in planted()])
def test_planted_mistakes_are_found(
    name: str,
    drawn_with: Callable[[Camera], Camera],
    layers: Callable[[View], dict[str, np.ndarray]],
    bracket: Scene,
    bracket_truths: Callable[[Camera], list[Truth]],
) -> None:
    """Within the widest of the bounds, so that they are found in whichever renderer makes them."""
    truth, renderer = bracket_truths(small(name))[0], RayRenderer(bracket)
    view = renderer.render(drawn_with(truth.camera), truth.pose)
    with pytest.raises(AssertionError):
        check(replace(view, layers={**view.layers, **layers(view)}), truth, WIDEST)


@pytest.mark.parametrize("name", CAMERAS)
def test_what_has_no_planted_mistake_passes(
    name: str, bracket: Scene, bracket_truths: Callable[[Camera], list[Truth]]
) -> None:
    truth = bracket_truths(small(name))[0]
    check(RayRenderer(bracket).render(truth.camera, truth.pose), truth, WIDEST)
