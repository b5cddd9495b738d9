"""Lenses obey the lens formula; chapter 5's numbers come out, where they can; published tables agree to rounding."""

from __future__ import annotations

import csv
from math import inf, isinf

import numpy as np
import pytest
from scipy.optimize import minimize_scalar
from scipy.special import j1

from cadcam.camera.optics import (
    Optics,
    lens_class,
    solve_optics,
    standard_lenses,
    viewing_angle_deg,
)
from cadcam.camera.sensor_format import CHIPS, FORMATS, SensorFormat, sensor_format
from cadcam.errors import BadValue, UnknownName

HALF_INCH = sensor_format("1/2")
THESIS = SensorFormat("1/2 as printed, nine tenths", (5.94, 3.96), (720, 575))
ROUNDING = 8 * np.finfo(float).eps
FULL_FRAME = FORMATS["full-frame"]


@pytest.fixture
def printed(shared):
    rows = csv.reader(shared("thesis/tables/ch5_scalars.csv").read_text().splitlines())
    return {row[0]: float(row[1]) for row in rows if len(row) == 3 and row[0] != "name"}


def test_sixteen_millimetres_at_six_metres_see_what_eq_2_3_says(golden):
    width, height = Optics(THESIS, 16.0, 6000.0).field_mm
    assert width == pytest.approx(golden("lens.W")["value"], abs=1e-9)
    assert height == pytest.approx(golden("lens.H")["value"], abs=1e-9)


def test_fig_5_3_is_read_four_square_metres_where_its_own_formula_gives_three_and_a_third(printed):
    optics = Optics(THESIS, printed["lens"], 1000 * printed["distance"])
    width, height = optics.field_mm
    area = width * height / 1e6
    assert area == pytest.approx(3.29, abs=0.005)
    assert area < 0.83 * printed["area"]
    assert optics.mm_per_pixel[0] == pytest.approx(3.09, abs=0.005)
    assert width > 1.05 * printed["width"]  # 2100 mm are read from the diagram; with them 2.92 mm, "about 3"
    approximate = 6000 / 16 * np.array(THESIS.size_mm)
    assert approximate.prod() / 1e6 == pytest.approx(3.31, abs=0.005)
    standard = Optics(HALF_INCH.effective(), 16.0, 6000.0).field_mm
    assert np.allclose(standard, [2154.24, 1615.68])


def test_the_half_inch_format_is_6_4_by_4_8_not_6_6_by_4_4(shared):
    rows = csv.reader(shared("thesis/tables/ccd_sizes.csv").read_text().splitlines())
    sizes = {row[0]: np.array(row[1:], float) for row in rows if len(row) == 5 and row[0] != "format"}
    assert HALF_INCH.size_mm == (6.4, 4.8)
    assert tuple(sizes["1/2"][:2]) == (6.6, 4.4)
    assert np.allclose(HALF_INCH.effective().size_mm, (5.76, 4.32))
    for name, size in FORMATS.items():  # all classic formats up to 1 inch have sides of 4:3
        if name in ("1/4", "1/3", "1/2", "1/1.8", "2/3", "1"):
            assert size.size_mm[0] / size.size_mm[1] == pytest.approx(4 / 3, rel=1e-12)
    assert np.allclose(FORMATS["2/3"].effective().size_mm, sizes["2/3"][2:])  # this one is printed right


def test_the_viewing_angle_is_that_of_section_5_2(golden):
    assert viewing_angle_deg(5.94, 16.0) == pytest.approx(golden("lens.angle")["value"], abs=1e-9)


def test_section_5_2_calls_wide_angle_what_is_tele_and_tele_what_is_wide():
    assert lens_class(viewing_angle_deg(6.4, 50.0)) == "tele"  # 7 degrees; printed: below 15 is wide angle
    assert lens_class(viewing_angle_deg(6.4, 16.0)) == "normal"
    assert lens_class(viewing_angle_deg(6.4, 3.5)) == "wide angle"  # 85 degrees; printed: above 60 is tele


def test_shutter_times_in_section_5_1_are_seconds():
    """A crane that creeps at 50 mm/s smears 0.26 px in 1/60 s; in 1/60 ms nobody would have to choose a shutter."""
    optics = Optics(HALF_INCH.with_pixels((768, 576)), 16.0, 6000.0)
    assert optics.motion_px(50.0, 1 / 60) == pytest.approx(50 / 60 / optics.mm_per_pixel[0])
    assert 0.2 < optics.motion_px(50.0, 1 / 60) < 0.3
    assert optics.motion_px(50.0, 1 / 60 / 1000) < 0.001


def test_the_f_numbers_of_section_5_2_are_focal_length_by_diameter():
    for f_number, diameter in ((0.8, 20.0), (1.6, 10.0)):
        assert Optics(HALF_INCH, 16.0, 6000.0, f_number).aperture_mm == pytest.approx(diameter)


@pytest.mark.parametrize("focal", [4.0, 16.0, 75.0])
@pytest.mark.parametrize("distance", [200.0, 6000.0, 1e6])
def test_the_lens_formula_and_similar_triangles_hold(focal, distance):
    optics = Optics(HALF_INCH, focal, distance)
    c = optics.camera_constant_mm
    assert 1 / distance + 1 / c == pytest.approx(1 / focal, rel=ROUNDING)
    assert optics.field_mm[0] / distance == pytest.approx(HALF_INCH.size_mm[0] / c, rel=1e-9)
    assert optics.magnification == pytest.approx(HALF_INCH.size_mm[1] / optics.field_mm[1], rel=1e-9)


@pytest.mark.parametrize("unknown", ["focal_mm", "distance_mm", "width_mm"])
def test_any_of_three_is_found_from_the_other_two(unknown):
    optics = Optics(HALF_INCH, 12.5, 3210.0)
    all_of = {"focal_mm": 12.5, "distance_mm": 3210.0, "width_mm": optics.field_mm[0]}
    solved = solve_optics(HALF_INCH, **{k: v for k, v in all_of.items() if k != unknown})
    assert solved.focal_mm == pytest.approx(12.5, rel=1e-12)
    assert solved.distance_mm == pytest.approx(3210.0, rel=1e-12)
    assert solved.field_mm[0] == pytest.approx(all_of["width_mm"], rel=1e-12)


def test_two_metres_at_six_on_half_an_inch_take_a_sixteen_millimetre_lens():
    optics = solve_optics(HALF_INCH, distance_mm=6000.0, width_mm=2000.0)
    assert optics.focal_mm == pytest.approx(6000 * 6.4 / 2006.4)
    shorter, longer = standard_lenses(optics)
    assert (shorter.focal_mm, longer.focal_mm) == (16.0, 25.0)
    assert shorter.field_mm[0] > 2000 > longer.field_mm[0]
    assert [o.focal_mm for o in standard_lenses(Optics(HALF_INCH, 16.0, 500.0))] == [16.0]


# www.ayton.id.au, wiki, photo:fov: horizontal, vertical, diagonal, in degrees, full frame; as printed to 0.1
FIELDS_OF_VIEW = [(50, 39.6, 27.0, 46.8)]
# lensviewing.com, "Angle in degrees": horizontal, full frame
HORIZONTAL = [(12, 112.6), (14, 104.3), (15, 100.4), (17, 93.3)]


def test_published_angles_of_view_come_out_to_rounding():
    """Ayton's row of 50 mm; his longer lenses are scaled from it without the tangent, and ours differ."""
    focal, across, down, diagonal = FIELDS_OF_VIEW[0]
    assert np.allclose(Optics(FULL_FRAME, focal, inf).angles_deg, (across, down, diagonal), atol=0.05)
    for focal, across in HORIZONTAL:
        assert Optics(FULL_FRAME, focal, inf).angles_deg[0] == pytest.approx(across, abs=0.06)


def test_a_published_hyperfocal_distance_comes_out_to_rounding():
    """50 mm at f/8, circle of confusion 0.03 mm: 10,467 mm (calculators9.com, depth-of-field calculator, example)."""
    assert Optics(FULL_FRAME, 50.0, 3000.0, 8.0).hyperfocal_mm(0.03) == pytest.approx(10467, abs=0.5)


def test_focused_at_hyperfocal_fractions_depth_of_field_is_consecutive():
    """At H/n it reaches from H/(n+1) to H/(n-1) (Wikipedia, "Hyperfocal distance"), all less a focal length."""
    H = Optics(FULL_FRAME, 50.0, 3000.0, 8.0).hyperfocal_mm(0.03) - 50.0
    for n in (1, 2, 3, 5):
        near, far = Optics(FULL_FRAME, 50.0, H / n + 50.0, 8.0).depth_of_field(0.03)
        assert near - 50.0 == pytest.approx(H / (n + 1), rel=50.0 / H * n)
        assert isinf(far) if n == 1 else far == pytest.approx(H / (n - 1), rel=0.05)


@pytest.mark.parametrize("distance", [300.0, 1500.0])
def test_at_the_ends_of_the_depth_of_field_the_blur_is_what_was_allowed(distance):
    chip = sensor_format("IMX264")
    optics = Optics(chip, 25.0, distance, 5.6)
    for blur_px in (1.0, 2.5):
        for z in optics.depth_of_field(blur_px * chip.pitch_mm[0]):
            assert optics.defocus_px(z) == pytest.approx(blur_px, rel=1e-9)
    assert optics.defocus_px(distance) == 0
    assert optics.depth_of_field() == optics.depth_of_field(chip.pitch_mm[0])


def test_from_the_hyperfocal_distance_on_everything_far_is_sharp():
    optics = Optics(HALF_INCH.with_pixels((768, 576)), 8.0, 6000.0, 8.0)
    assert optics.distance_mm > optics.hyperfocal_mm()
    assert optics.depth_of_field()[1] == inf
    assert Optics(optics.sensor, 8.0, inf, 8.0).depth_of_field()[0] == pytest.approx(optics.hyperfocal_mm() - 8.0)


def test_diffraction_is_the_airy_disc():
    """At f/8 in green it is 2.44 0.55 8 = 10.7 um wide: three pixels of 3.45 um."""
    optics = Optics(sensor_format("IMX264"), 25.0, 1e9, 8.0)
    assert optics.diffraction_px() == pytest.approx(2.44 * 0.55 * 8 / 3.45, rel=1e-6)
    near = Optics(sensor_format("IMX264"), 25.0, 50.0, 8.0)  # life-size: the effective f-number doubles
    assert near.diffraction_px() == pytest.approx(2 * optics.diffraction_px(), rel=1e-6)


def test_the_core_of_the_airy_disc_is_nearly_a_gaussian():
    """The nearest one to (2 J1(x)/x)^2, x = pi r/(lambda N), within its first dark ring, by squares over the area."""
    optics = Optics(sensor_format("IMX264"), 25.0, 1e9, 8.0)
    r = np.linspace(1e-6, 1.22, 2000)  # of lambda N
    airy = (2 * j1(np.pi * r) / (np.pi * r)) ** 2
    off = minimize_scalar(
        lambda s: float(np.sum(r * (airy - np.exp(-(r**2) / (2 * s**2))) ** 2)), bounds=(0.2, 0.8), method="bounded"
    )
    assert optics.airy_sigma_px() == pytest.approx(off.x * 0.55 * 8 / 3.45, rel=0.02)  # 0.42 has two digits


def test_motion_and_the_longest_exposure_are_one_rule():
    optics = Optics(sensor_format("IMX174"), 16.0, 1000.0)
    t = optics.longest_exposure_s(300.0, 0.5)
    assert optics.motion_px(300.0, t) == pytest.approx(0.5)
    assert optics.longest_exposure_s(0.0, 0.5) == inf


def test_the_camera_of_some_optics_sees_their_field():
    optics = Optics(sensor_format("IMX273"), 8.0, 700.0)
    camera, (width, height) = optics.camera(), optics.field_mm
    corner = camera.project(np.array([-width / 2, -height / 2, 700.0]))
    assert np.allclose(corner, [-0.5, -0.5], atol=1e-9)


def test_inch_formats_are_about_two_thirds_of_their_inches_across():
    for name in ("1/3", "1/2", "2/3", "1"):
        inches = np.divide(*map(float, name.split("/"))) if "/" in name else 1.0
        assert FORMATS[name].diagonal_mm / (25.4 * inches) == pytest.approx(0.65, abs=0.08)


def test_a_sensor_has_a_format_a_chip_or_a_size():
    assert sensor_format('1/2"').size_mm == (6.4, 4.8)
    assert sensor_format("imx264") is CHIPS["IMX264"]
    assert sensor_format("5.94x3.96").size_mm == (5.94, 3.96)
    assert sensor_format("5.94 x 3.96 mm").size_mm == (5.94, 3.96)
    with pytest.raises(UnknownName, match="did you mean 'IMX264'"):
        sensor_format("IMX2640")
    with pytest.raises(BadValue, match="positive"):
        sensor_format("0x3")


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Optics(HALF_INCH, 16.0, 10.0), "more than the focal length of 16 mm"),
        (lambda: Optics(HALF_INCH, 16.0, 16.0), "nothing nearer"),
        (lambda: Optics(HALF_INCH, 0.0, 10.0), "focal length is 0"),
        (lambda: Optics(HALF_INCH, 0.016, 2000.0), "look over 179.4 degrees of width; expected mm: 0.016 m are 16 mm"),
        (lambda: Optics(HALF_INCH, float("nan"), 10.0), "focal length is nan"),
        (lambda: Optics(HALF_INCH, 16.0, 600.0, 0.0), "f-number is 0"),
        (lambda: Optics(HALF_INCH, 16.0, 600.0, image_circle_mm=6.0), "diagonal of the sensor .* 8 mm"),
        (lambda: Optics(HALF_INCH, 16.0, 600.0, image_circle_mm=np.nan), "diagonal of the sensor .* 8 mm"),
        (lambda: Optics(HALF_INCH, 16.0, 600.0).mm_per_pixel, "pixels of sensor"),
        (lambda: Optics(HALF_INCH, 16.0, 600.0).depth_of_field(0.01), "f-number is not given"),
        (lambda: solve_optics(HALF_INCH, focal_mm=16.0), "two of focal_mm"),
        (lambda: solve_optics(HALF_INCH, focal_mm=16.0, distance_mm=600.0, width_mm=3.0), "two of focal_mm"),
        (lambda: solve_optics(HALF_INCH, focal_mm=16.0, width_mm=-3.0), "width_mm is -3"),
        (lambda: HALF_INCH.effective(1.2), "at most 1"),
        (lambda: HALF_INCH.with_pixels((0, 5)), "positive whole"),
    ],
)
def test_impossible_optics_are_refused(make, message):
    with pytest.raises(BadValue, match=message):
        make()


def test_a_lens_focused_at_infinity_has_numbers_for_all_that_is_asked() -> None:
    optics = Optics(CHIPS["IMX264"], 8.0, inf, 4.0)
    assert optics.mm_per_pixel == (inf, inf)
    assert optics.motion_px(100.0, 0.01) == 0.0
    assert optics.longest_exposure_s(100.0, 0.5) == inf
    assert optics.camera().fx == pytest.approx(8.0 / 0.00345)
