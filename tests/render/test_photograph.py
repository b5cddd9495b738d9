"""Photographs are what a thin lens makes of a scene: unmoved discs of blur that cover what is behind; true shadows."""

from __future__ import annotations

import re
import tracemalloc
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.special import ndtr

from cadcam.cad.mesh import Mesh, merge
from cadcam.camera.aperture import Aperture
from cadcam.camera.camera import Camera
from cadcam.camera.lens import BrownConrady
from cadcam.camera.optics import Optics
from cadcam.camera.sensor_format import sensor_format
from cadcam.errors import BadValue, UnknownName
from cadcam.geometry.rigid import Rigid
from cadcam.image.sensor.light import Blur, Vignetting
from cadcam.image.sensor.presets import GLOBAL_SHUTTER
from cadcam.image.sensor.sensor import Sensor
from cadcam.render import open_renderer, photograph
from cadcam.render.light import LIGHTS, Lamp, Light, named_light
from cadcam.render.photograph import Photographer, behind, blur_before
from cadcam.render.samples import pairing, renderings, sample_points
from cadcam.render.view import Channel, Scene

EVEN = LIGHTS["even"]
HERE = Rigid()
CAMERA = Camera.from_focal((64, 48), 400.0)
FLOAT = 4 * float(np.finfo(np.float32).eps)
LENS = BrownConrady(k1=-0.25, k2=0.05, p1=1e-3)


def plate(x0, x1, z, *, y=(-1000.0, 1000.0), name="plate"):
    corners = np.array([[x0, y[0], z], [x1, y[0], z], [x1, y[1], z], [x0, y[1], z]])
    return Mesh.single(corners, np.array([[0, 2, 1], [0, 3, 2]]), name=name)


def scene(*plates_and_grey):
    plates, grey = zip(*plates_and_grey, strict=True)
    return Scene.of(merge(plates), colors=np.repeat(np.array(grey)[:, None], 3, axis=1))


def step_edge(z, at_px=0.0):
    """A wall, black on the left and white on the right of a pixel's place beside the middle."""
    x = at_px / CAMERA.fx * z
    return scene((plate(-1e3, x, z, name="black"), 0.0), (plate(x, 1e3, z, name="white"), 1.0))


def row_of(picture):
    assert np.ptp(picture, axis=0).max() < 1e-5  # a vertical edge: all rows alike
    return picture[0, :, 0].astype(np.float64)


@pytest.mark.parametrize("z", [500.0, 800.0])
@pytest.mark.parametrize("samples", [16, 64, 256])
def test_an_edge_out_of_focus_is_spread_by_the_disc_of_the_optics_and_moved_nowhere(z, samples):
    """Its derivative has the second moment of disc and pixel, d^2/16 + 1/12 (a wrong shear doubles or loses d)."""
    aperture = Aperture(36.0, 650.0)
    row = row_of(
        Photographer(step_edge(z)).radiance(CAMERA, HERE, light=EVEN, aperture=aperture, samples=samples).color
    )
    d = float(aperture.defocus_px(CAMERA, z))
    assert d > 4
    spread, middle = np.diff(row), np.arange(63) + 0.5 - 31.5
    assert spread.sum() == pytest.approx(1, abs=1e-6)
    assert spread @ middle == pytest.approx(0, abs=64 * FLOAT)
    # + 1/12: the derivative is taken between pixels
    assert spread @ middle**2 == pytest.approx(d**2 / 16 + 1 / 12 + 1 / 12, rel=4 / samples)
    assert np.allclose(row + row[::-1], 1, atol=FLOAT)


@pytest.mark.parametrize("samples", [1, 2, 5, 64])
def test_a_step_is_told_of_each_rendering(samples):
    steps = []
    Photographer(step_edge(700.0)).radiance(CAMERA, HERE, light=EVEN, samples=samples, step=lambda: steps.append(1))
    assert len(steps) == renderings(samples) == len(sample_points(samples)) >= samples


def test_what_is_in_focus_is_as_sharp_as_through_a_pinhole():
    photographer = Photographer(step_edge(700.0, at_px=2.3))
    sharp = photographer.radiance(CAMERA, HERE, light=EVEN, samples=64)
    focused = photographer.radiance(CAMERA, HERE, light=EVEN, aperture=Aperture(30.0, 700.0), samples=64)
    assert np.allclose(sharp.color, focused.color, atol=FLOAT)
    assert row_of(sharp.color)[34] == pytest.approx(0.7, abs=1 / 64)  # the edge at 33.8: pixel 34 spans 33.5 to 34.5


@pytest.mark.parametrize("focus", [400.0, 800.0])
def test_near_things_spread_over_far_ones_and_far_ones_never_over_near_ones(focus):
    """Against the integral over pixel and opening itself, worked out on the two planes in closed form per point."""
    near, far, aperture = 400.0, 800.0, Aperture(8.0, focus)
    stripes = [(plate(-1e3 + 10 * k, -990 + 10 * k, far, name=f"s{k}"), float(k % 2)) for k in range(200)]
    picture = scene((plate(-1e3, 3.0, near, name="near"), 0.5), *stripes)
    row = row_of(Photographer(picture).radiance(CAMERA, HERE, light=EVEN, aperture=aperture, samples=256).color)
    truth = integral(near, far, 3.0, aperture)
    assert np.abs(row - truth).max() < 0.04
    if focus == near:  # the near edge is sharp, and left of it nothing of the blurred stripes shines through
        edge = CAMERA.project(np.array([3.0, 0, near]))[0]
        assert np.allclose(row[: int(edge)], 0.5, atol=FLOAT)
    else:  # the stripes are sharp, up to where the near plate's disc reaches them
        reach = float(aperture.defocus_px(CAMERA, near)) / 2
        assert np.ptp(row[int(CAMERA.project(np.array([3.0, 0, near]))[0] + reach) + 2 :]) == pytest.approx(
            1, abs=FLOAT
        )


def integral(near, far, edge, aperture):
    """The mean over 64 x 64 points of pixel and opening of grey 0.5 on the near plane, else stripes 10 mm wide."""
    u = aperture.diameter_mm / 2 * np.sin(np.pi / 2 * ((np.arange(4096) + 0.5) / 2048 - 1))  # even steps of angle ...
    weight = np.cos(np.pi / 2 * ((np.arange(4096) + 0.5) / 2048 - 1)) ** 2  # ... of which a disc's chords have so much
    x = np.arange(64)[:, None, None] + ((np.arange(64) + 0.5) / 64 - 0.5)[:, None] - 31.5
    slope = x / CAMERA.fx - u / aperture.focus_mm
    covered = u + slope * near < edge
    white = np.floor((u + slope * far) / 10) % 2 == (np.floor(1000 / 10) + 1) % 2
    return np.average(np.where(covered, 0.5, white), axis=2, weights=weight).mean(axis=1)


def test_the_opening_of_some_optics_blurs_as_they_say():
    optics = Optics(sensor_format("IMX264"), 25.0, 900.0, 4.0)
    camera, aperture = optics.camera(), Aperture.of(optics)
    for z in (300.0, 900.0, 5000.0):
        assert aperture.defocus_px(camera, z) == pytest.approx(optics.defocus_px(z), rel=1e-12, abs=1e-12)
    assert aperture.diffraction_px(camera) == pytest.approx(optics.diffraction_px() / 2.44 * 0.42, rel=1e-12)


@pytest.mark.parametrize("renderer", ["raster", "ray"])
def test_a_distorting_lens_bends_sharp_and_blurred_things_alike(renderer):
    """In the focus plane nothing moves; out of it the edge's middle stays where the lens puts it."""
    camera = replace(CAMERA, lens=LENS)
    for z in (700.0, 1100.0):
        photographer = Photographer(step_edge(z, at_px=14.0), renderer=renderer)
        pinhole = photographer.radiance(camera, HERE, light=EVEN, samples=64).color
        blurred = photographer.radiance(camera, HERE, light=EVEN, aperture=Aperture(4.0, 700.0), samples=64).color
        assert np.abs(blurred.sum(axis=1) - pinhole.sum(axis=1)).max() < (0.02 if z == 700.0 else 0.05)
        assert (np.abs(blurred - pinhole).max() < 0.03) == (z == 700.0)


@pytest.mark.parametrize("lens", [None, LENS])
def test_one_sample_is_the_renderer_s_own_picture(lens):
    camera = Camera.from_focal((64, 48), 400.0, fy=380.0, cx=30.0, skew=1.5, lens=lens)
    picture = step_edge(700.0)
    view = open_renderer(picture).render(camera, HERE, channels=Channel.PART | Channel.IMAGE)
    one = Photographer(picture).radiance(camera, HERE, light=EVEN, samples=1)
    assert np.array_equal(one.color[..., 0], picture.colors[view.part][..., 0] * (view.part >= 0))


def test_a_plate_over_a_floor_casts_the_shadow_that_geometry_says():
    """Lamp at 45 degrees along x, plate 100 mm above the floor: its shadow is the plate moved by 100 mm.

    A lamp that looks s wide makes a penumbra 100 (tan(45 + s/2) - tan(45 - s/2)) wide, with as much light in it.
    """
    floor = plate(-1e3, 1e3, 0.0, name="floor")
    picture = scene((floor, 0.8), (plate(-50.0, 50.0, 100.0, y=(-40.0, 40.0), name="lid"), 0.8))
    pose = Rigid.look_at([0, 0, 2000.0], [0, 0, 0], up=(0, 1, 0))
    camera = Camera.from_focal((200, 80), 800.0)
    photographer = Photographer(picture)
    for size_deg in (0.0, 10.0):
        light = Light((Lamp((-1.0, 0.0, 1.0), 1.0, size_deg),))
        line = photographer.radiance(camera, pose, light=light, samples=64).color[40, :, 0].astype(np.float64)
        lit, mm = 0.8 * np.sqrt(0.5), 2000.0 / 800.0
        x = (np.arange(200) - 99.5) * mm
        floor_seen = np.abs(x) > 54  # the lid covers -50 .. 50 as seen, a little larger for being nearer
        dark = np.where(floor_seen, 1 - line / lit, np.nan)
        half = 50 * (np.tan(np.radians(45 + size_deg / 2)) - np.tan(np.radians(45 - size_deg / 2)))
        assert np.nanmax(np.abs(dark[x > 152 + half])) < 0.02
        assert np.nanmax(np.abs(dark[x < -54])) < 0.02
        assert np.allclose(dark[(x > 56 + half) & (x < 148 - half)], 1, atol=0.02)
        shadow = np.nansum(dark[x > 54]) * mm + x[x > 54][0] - mm / 2
        assert shadow == pytest.approx(150, abs=0.1 if size_deg == 0 else 2.0)
        assert np.any((dark > 0.1) & (dark < 0.9) & (x > 150 - 0.8 * half) & (x < 150 - 2 * mm)) == (size_deg > 0)


def edge_in_part_of_a_lamp(angle):
    """Return how far (px) an edge of paint is drawn off where a far lid leaves some of a lamp in sight; angle: which.

    The lid's border is straight, and so far off that all of the picture sees the same part of the lamp.
    """
    c, s = np.cos(angle), np.sin(angle)
    corners = np.array([[0.0, 0.0], [0.0, 2e6], [1e6, 2e6], [1e6, 0.0]]) - [-1e5, 1e6]
    lid = Mesh.single(np.column_stack([corners @ [[c, s], [-s, c]], np.full(4, -1e6)]), [[0, 2, 1], [0, 3, 2]])
    picture = scene((plate(-1e3, 0, 500.0), 0.0), (plate(0, 1e3, 500.0, name="white"), 1.0), (lid, 0.0))
    light = Light((Lamp((0, 0, -1.0), 1.0, 30.0),))
    got = Photographer(picture).radiance(CAMERA, HERE, light=light, blur_px=0.5, samples=16).color[..., 0]
    line = got.astype(np.float64).mean(axis=0)
    assert 0 < line[-1] < 0.95  # of the lamp not all is in sight
    return 32 - line.sum() / line[-1]


def test_an_edge_in_half_shadow_is_drawn_in_its_place(monkeypatch):
    """The points of the pixel that go with those of a lamp in sight had a mean of up to 0.33 px."""
    angles = np.radians(np.arange(10, 370, 40))
    assert max(abs(edge_in_part_of_a_lamp(a)) for a in angles) < 0.05
    monkeypatch.setattr(photograph, "pairing", lambda n: np.zeros((1, 1), np.int64))
    assert max(abs(edge_in_part_of_a_lamp(a)) for a in angles) > 0.3


@pytest.mark.parametrize("n", [1, 2, 8, 16, 64])
def test_each_pixel_takes_every_point_of_a_lamp_once_and_its_neighbour_the_opposite_one(n):
    tile = pairing(n)
    assert np.array_equal(np.sort(tile.ravel()), np.arange(n))
    lamp = sample_points(n).lamp[tile]
    assert n == 1 or np.allclose(lamp[:, ::2], -lamp[:, 1::2])


def test_light_adds_up():
    """A wall that faces camera and lamp: reflectance times ambient, flash and lamp together; none shades itself."""
    picture = scene((plate(-1e3, 1e3, 500.0), 0.5))
    light = Light((Lamp((0, 0, -1.0), 0.3, 5.0),), flash=0.2, ambient=0.1)
    got = Photographer(picture).radiance(CAMERA, HERE, light=light, samples=32).color
    cosine = -CAMERA.unproject(CAMERA.pixel_grid())[..., 2]
    assert np.allclose(got[..., 0], 0.5 * (0.1 + 0.3 * np.cos(np.radians(2.5 * 0.67)) - 0.2 * cosine), atol=2e-4)
    assert np.ptp(got[20:28, 28:36]) < 1e-4


def test_points_of_samples_lie_round_their_middle_with_the_moments_of_square_and_disc():
    for n in (2, 16, 64, 1000):
        points = sample_points(n)
        assert len(points) == 1 << int(np.ceil(np.log2(n)))
        for kind in (points.pixel, points.opening, points.lamp):
            assert np.allclose(np.sort(kind, axis=0), np.sort(-kind, axis=0))
        assert np.allclose(np.mean(np.sum(points.opening**2, axis=1)), 0.5)
        assert np.allclose(np.diff(np.sort(points.pixel[:, 0])), 1 / len(points))
    assert not sample_points(1).pixel.any()


def test_a_sensor_behind_a_lens_does_not_blur_by_the_pixel_s_area_twice():
    aperture = Aperture(0.4, 1000.0)
    assert blur_before(GLOBAL_SHUTTER, CAMERA, None) ** 2 + 1 / 12 == pytest.approx(0.6**2)
    assert blur_before(Sensor(), CAMERA, None) == 0
    assert blur_before(Sensor(), CAMERA, aperture) == pytest.approx(0.42 * 0.55e-3 * 400 / 0.4)
    assert behind(GLOBAL_SHUTTER, CAMERA).blur is None
    assert behind(Sensor(blur=Blur(0.2, 3.0)), CAMERA).blur == Blur(0.0, 3.0)
    off = Camera.from_focal((64, 48), 400.0, cx=35.5)
    assert behind(GLOBAL_SHUTTER, off).vignetting == Vignetting(400.0, offset_px=(4.0, 0.0))
    assert behind(Sensor(), off).vignetting is None


@pytest.mark.parametrize("sigma", [0.3, 0.53, 2.0])
def test_blur_by_parts_of_a_pixel_is_that_of_a_gaussian_and_a_square_pixel(sigma):
    """At every phase of the grid: a kernel of pixels of 0.53 px would be off by 0.03 of the step."""
    for phase in (0.0, 0.3, 0.5):
        edge = step_edge(700.0, at_px=phase)
        row = row_of(Photographer(edge).radiance(CAMERA, HERE, light=EVEN, blur_px=sigma, samples=128).color)
        d = np.arange(64) - 31.5 - phase
        truth = np.mean([ndtr((d + h) / sigma) for h in (np.arange(200) + 0.5) / 200 - 0.5], axis=0)
        assert np.abs(row - truth).max() < 0.6 / 128


@pytest.mark.parametrize("lens", [None, LENS])
def test_a_photograph_lit_in_rows_is_the_one_lit_at_once_bit_by_bit(lens, monkeypatch):
    """Rows of the lens' plane are those of the whole plane, and shadows begin as far from their surface."""
    made = Photographer(scene((plate(-60.0, 60.0, 600.0), 0.7), (plate(-12.0, 9.0, 500.0, y=(-8, 30)), 0.4)))
    camera = replace(CAMERA, lens=lens or CAMERA.lens)
    light = Light((Lamp((0.3, -0.2, -1.0), 0.6, 15.0), Lamp((-0.5, 0.1, -1.0), 0.2)), flash=0.2, ambient=0.1)
    given = {"light": light, "aperture": Aperture(6.0, 520.0), "blur_px": 0.4, "samples": 4}
    together = made.radiance(camera, HERE, **given)
    monkeypatch.setattr(photograph, "_TOGETHER", 5 * 64)
    apart = made.radiance(camera, HERE, **given)
    assert together.color.std() > 0.01
    np.testing.assert_array_equal(apart.color, together.color)
    np.testing.assert_array_equal(apart.alpha, together.alpha)


def test_a_photograph_takes_little_memory_beside_what_is_seen(monkeypatch):
    """In bytes a pixel: 16 of the sum, 16 of the lens' plane, 20 of a view, 4 of each lamp; it was 220 in all."""
    monkeypatch.setattr(photograph, "_TOGETHER", 1 << 12)
    made = Photographer(scene((plate(-1e3, 1e3, 600.0), 0.7)))
    camera = Camera.from_focal((600, 400), 500.0)
    made.radiance(CAMERA, HERE, light=LIGHTS["hall"], samples=2)  # what is loaded and made once
    tracemalloc.start()
    made.radiance(camera, HERE, light=LIGHTS["hall"], samples=2)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak / (600 * 400) < 16 + 16 + 20 + 2 * 4 + 20  # 20: blocks, and views that are kept for the next frame


def test_a_photograph_is_the_radiance_seen_by_the_sensor_and_the_same_again_for_the_same_seed():
    photographer = Photographer(scene((plate(-20.0, 20.0, 500.0, y=(-10, 10)), 0.5)))
    wall = np.full((48, 64), 0.25, np.float32)
    plain = photographer.photograph(
        CAMERA, HERE, sensor=Sensor(), rng=np.random.default_rng(1), light=EVEN, samples=4, background=wall
    )
    assert np.allclose(plain, photographer.radiance(CAMERA, HERE, light=EVEN, samples=4).over((0.25, 0.25, 0.25)))
    twice = [
        photographer.photograph(CAMERA, HERE, sensor=GLOBAL_SHUTTER, rng=np.random.default_rng(7), samples=4)
        for _ in range(2)
    ]
    assert np.array_equal(*twice)
    assert 0.001 < np.std(twice[0][10:20, 30:40] - 0.5) < 0.2


def test_the_document_s_lines_run_as_printed():
    text = (Path(__file__).resolve().parents[2] / "docs" / "photographs.md").read_text()
    (lines,) = re.findall(r"```python\n(.*?)```", text, flags=re.DOTALL)
    box = plate(-300.0, 300.0, 3000.0, y=(-200.0, 200.0))
    names = {"mesh": box, "camera_from_world": HERE}
    exec(lines, names)
    picture = names["picture"]
    assert picture.shape == (270, 360, 3)
    assert 0.3 < picture[0, 0, 0] < 0.5  # the background, vignetted
    assert picture[135, 180].max() > 0.05


@pytest.mark.parametrize(
    ("make", "error", "message"),
    [
        (lambda: Aperture(0.0, 100.0), BadValue, "diameter of the aperture is 0 mm"),
        (lambda: Aperture(5.0, -1.0), BadValue, "focus distance is -1 mm"),
        (lambda: Lamp((0, 0, 0), 1.0), BadValue, "not zero"),
        (lambda: Lamp((0, 0, 1), -1.0), BadValue, "strength of the lamp"),
        (lambda: Lamp((0, 0, 1), 1.0, 200.0), BadValue, "from 0 to 90"),
        (lambda: Light(flash=float("nan")), BadValue, "flash"),
        (lambda: named_light("hal"), UnknownName, "did you mean 'hall'"),
        (lambda: sample_points(0), BadValue, "from 1 to 4096"),
        (lambda: sample_points(4097), BadValue, "from 1 to 4096"),
        (lambda: sample_points(float("nan")), BadValue, "samples is nan; expected a whole number from 1 to 4096"),
    ],
)
def test_impossible_light_and_lenses_are_refused(make, error, message):
    with pytest.raises(error, match=message):
        make()
