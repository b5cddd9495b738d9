"""Large pictures in strips: the same bits as at once, the tables of few strips at a time, ordinary sizes as ever."""

from __future__ import annotations

import threading
import weakref

import numpy as np
import pytest

from cadcam.cad.parts import machined_bracket
from cadcam.camera.camera import Camera
from cadcam.camera.lens import BrownConrady, Division, Fisheye, TiltedBrownConrady
from cadcam.errors import MissingCore
from cadcam.geometry.rigid import Rigid
from cadcam.native import core
from cadcam.render import lens_tables, strips
from cadcam.render.lens_tables import MAKING_BYTES, LensTables, plane_points, table_points
from cadcam.render.raster import RasterRenderer
from cadcam.render.strips import Grids
from cadcam.render.thin_lens import ThinLens
from cadcam.render.view import Channel, Look, View

from .scenes import scene_of, views_of

try:
    core.library()
except MissingCore as error:
    pytest.skip(str(error), allow_module_level=True)

BRACKET = machined_bracket()
OUTSIDE, INSIDE = views_of(BRACKET)
SIZE = (90, 67)  # px: the last strip is cut off
CAMERAS = {
    "Brown-Conrady": Camera.from_focal(SIZE, 80.0, skew=1.0, lens=BrownConrady(-0.28, 0.06, 1e-3, -2e-3)),
    "division": Camera.from_focal(SIZE, 60.0, cx=40.2, lens=Division(-0.35)),
    "fisheye past its circle": Camera.from_focal(SIZE, 26.0, cx=55.3, cy=35.1, lens=Fisheye(0.01, -0.003)),
    "Scheimpflug": Camera.from_focal(SIZE, 70.0, lens=TiltedBrownConrady(-0.2, tau_x=0.2, tau_y=-0.15)),
}
LARGE = Camera.from_focal((6000, 4000), 7000.0, lens=BrownConrady(-0.1))
ALL = Channel.ALL | Channel.RGB


@pytest.fixture
def in_strips(monkeypatch: pytest.MonkeyPatch) -> None:
    """Draw everything through a lens in strips of eight rows, three at a time at most."""
    monkeypatch.setattr(strips, "WHOLE_BYTES", 0)
    monkeypatch.setattr(strips, "STRIP_BYTES", 0)
    monkeypatch.setattr(strips, "AT_ONCE_BYTES", 3 * MAKING_BYTES * SIZE[0] * 8 * 10)


class Recorder:
    """Lens tables as they are made and let go: `most` samples of them existed at any time."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.sizes: list[tuple[int, int]] = []
        self.now = self.most = 0
        self._lock = threading.Lock()
        for module in (strips, lens_tables):
            monkeypatch.setattr(module, "NativeLens", self._made)
        monkeypatch.setattr("cadcam.render.raster.TABLES", LensTables())

    def _made(self, points: np.ndarray) -> core.NativeLens:
        made = core.NativeLens(points)
        self._count(made.size[0] * made.size[1])
        self.sizes.append(made.size)
        weakref.finalize(made, self._count, -made.size[0] * made.size[1])
        return made

    def _count(self, samples: int) -> None:
        with self._lock:
            self.now += samples
            self.most = max(self.most, self.now)


def same(one: View, other: View) -> bool:
    return all(one.layers[name].tobytes() == other.layers[name].tobytes() for name in one.layers)


@pytest.mark.parametrize("n", [1, 2, 3])
@pytest.mark.parametrize("name", CAMERAS)
def test_strips_are_the_picture_drawn_at_once_bit_by_bit(name: str, n: int, request: pytest.FixtureRequest) -> None:
    at_once = RasterRenderer(scene_of(BRACKET), threads=2)
    camera, look = CAMERAS[name], Look(supersampling=n)
    whole = [at_once.render(camera, pose, channels=ALL, look=look) for pose in (OUTSIDE, INSIDE)]
    colours = at_once.render(camera, OUTSIDE, channels=Channel.RGB, look=look)
    request.getfixturevalue("in_strips")
    assert len(Grids(camera, (1, n)).strips()) == 9
    for threads in (1, 4):
        renderer = RasterRenderer(scene_of(BRACKET), threads=threads)
        for pose, view in zip((OUTSIDE, INSIDE), whole, strict=True):
            assert same(renderer.render(camera, pose, channels=ALL, look=look), view)
        batch = renderer.render_batch(camera, (OUTSIDE, INSIDE), channels=ALL, look=look)
        assert all(same(one, view) for one, view in zip(batch, whole, strict=True))
        assert same(renderer.render(camera, OUTSIDE, channels=Channel.RGB, look=look), colours)
    assert whole[0].mask.any()


@pytest.mark.parametrize("n", [1, 3])
@pytest.mark.parametrize("name", CAMERAS)
def test_a_table_of_some_rows_is_that_part_of_the_whole_bit_by_bit(
    name: str, n: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also where rows begin within a block of those that are unprojected together, and iterated as long as all need."""
    camera = CAMERAS[name]
    monkeypatch.setattr(lens_tables, "_CACHED", 5 * camera.width)
    whole = table_points(camera, n)
    assert whole.shape == (n * camera.height, n * camera.width, 2)
    for rows in (slice(0, 1), slice(3, 11), slice(24, 25), slice(60, 67)):
        assert table_points(camera, n, rows).tobytes() == whole[n * rows.start : n * rows.stop].tobytes()
        assert plane_points(camera, rows).tobytes() == plane_points(camera)[rows].tobytes()


@pytest.mark.usefixtures("in_strips")
@pytest.mark.parametrize("threads", [1, 2, 8])
def test_no_more_tables_exist_than_are_drawn_through(threads: int, monkeypatch: pytest.MonkeyPatch) -> None:
    tables = Recorder(monkeypatch)
    view = RasterRenderer(scene_of(BRACKET), threads=threads).render(
        CAMERAS["division"], OUTSIDE, look=Look(supersampling=3)
    )
    assert view.mask.any()
    strip = SIZE[0] * 8 * (1 + 9)
    assert tables.most <= strip * min(threads, 3)
    assert tables.now == 0
    assert sorted(set(tables.sizes)) == [(90, 3), (90, 8), (270, 9), (270, 24)]


def test_the_tables_of_24_megapixels_stay_within_the_bound_whatever_the_threads() -> None:
    for n in (2, 3, 4):
        grids = Grids(LARGE, (1, n))
        strip = max(s.stop - s.start for s in grids.strips()) * 6000 * (1 + n * n) * MAKING_BYTES
        assert not grids.whole
        assert grids.table_bytes(1) == strip <= strips.STRIP_BYTES
        assert 2 * strip == grids.table_bytes(2) < grids.table_bytes(64) <= strips.AT_ONCE_BYTES
        rows = [row for s in grids.strips() for row in range(s.start, s.stop)]
        assert rows == list(range(4000))


@pytest.mark.parametrize(("size", "n"), [((1920, 1080), 3), ((2448, 2048), 3), ((4096, 3000), 1), ((6000, 4000), 1)])
def test_ordinary_pictures_are_drawn_at_once(size: tuple[int, int], n: int) -> None:
    assert Grids(Camera.from_focal(size, 3000.0, lens=BrownConrady(-0.1)), (1, n)).whole


def test_the_tables_of_an_ordinary_picture_are_made_once(monkeypatch: pytest.MonkeyPatch) -> None:
    tables, renderer = Recorder(monkeypatch), RasterRenderer(scene_of(BRACKET))
    for pose in (OUTSIDE, INSIDE):
        renderer.render(CAMERAS["division"], pose, look=Look(supersampling=3))
    assert tables.sizes == [SIZE, (270, 201)]


def test_a_lens_that_does_not_come_back_is_not_worth_keeping() -> None:
    """Those of a photograph's renderings, for example, each from its own point of the opening."""
    camera = Camera.from_focal((1920, 1080), 1800.0, lens=BrownConrady(-0.1))
    seen = ThinLens(camera, None).pinhole(Rigid(), np.array([0.1, 0.2]), np.zeros(2)).camera
    assert Grids(camera, (1,)).whole
    assert not Grids(seen, (1,)).whole


def test_colours_alone_need_no_table_of_the_centres(monkeypatch: pytest.MonkeyPatch) -> None:
    tables = Recorder(monkeypatch)
    RasterRenderer(scene_of(BRACKET)).render(
        CAMERAS["division"], OUTSIDE, channels=Channel.IMAGE | Channel.RGB, look=Look(supersampling=3)
    )
    assert tables.sizes == [(270, 201)]


def test_without_distortion_there_are_no_tables() -> None:
    grids = Grids(Camera.from_focal((60_000, 60_000), 7000.0), (1,))
    assert grids.whole
    assert grids.table_bytes(64) == 0
