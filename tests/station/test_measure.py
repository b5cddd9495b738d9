"""Marks measured in a hall: errors are those that the covariance says, and what cannot be measured is refused."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

from cadcam.camera.camera import Camera
from cadcam.errors import BadValue, TooFewPoints, UnknownName
from cadcam.station.budget import Budget, budget_of
from cadcam.station.gantry import Repeatability, Sighting, calibrate_gantry
from cadcam.station.hall import Visit, make_hall
from cadcam.station.interpolation import RULES
from cadcam.station.measure import estimates, measure_marks, repeatability
from cadcam.station.simulate import calibrate_robot, day, distances, sight


def stiff(rng):
    """A hall whose mechanics does not bend: what is left are pixels, survey, plate and repeatability."""
    return make_hall(rng, robots=("6",), deflection_mm=1e-6)


@pytest.mark.parametrize(
    "rule", [pytest.param(rule, marks=[pytest.mark.slow] * (rule not in ("nearest", "b4"))) for rule in RULES]
)
def test_errors_are_those_of_the_covariance_in_a_stiff_hall(rule):
    """Twelve halls, one mark each: 24 errors, an rms of 1 +- 0.14."""
    z = []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        hall = stiff(rng)
        one = calibrate_robot(hall, "6", rng, columns=2, rows=2).station
        again = Repeatability.stated(hall.repeatability_mm, hall.repeatability_mm)
        station = calibrate_gantry("6", one.positions, repeatability=again)
        work = day(hall, rng, marks=1)
        found = measure_marks(station, work.sightings, rule=rule)
        z.append((found.points[:, :2] - work.points) / found.sigma[:, :2])
    assert np.sqrt(np.mean(np.square(z))) == pytest.approx(1, abs=0.45)


def test_distances_know_what_two_marks_have_in_common(hall, stations, rng):
    at = stations["6"].grid[7]
    p = hall.view_centre("6", at)
    seen = [sight(hall, name, "6", at, p + off, rng) for name, off in (("A", [0, 0]), ("B", [60, 0]))]
    found = measure_marks(stations["6"], seen)
    alone = np.hypot(*found.sigma[:, 0])
    assert found.distance("A", "B").sigma < 0.9 * alone


def test_a_distance_has_the_variance_that_the_joint_covariance_gives_it(hall, stations, rng):
    found = measure_marks(stations, day(hall, rng, marks=9).sightings)
    for one, other in combinations(found.names, 2):
        d = found.point(other) - found.point(one)
        gradient = np.concatenate([-d, d]) / np.linalg.norm(d)
        variance = gradient @ found.joint_covariance(one, other) @ gradient
        assert found.distance(one, other).sigma ** 2 == pytest.approx(variance, rel=1e-9)


def test_a_day_s_distances_are_within_what_is_stated(hall, stations, rng):
    """One hall: how rough its mechanics is between the positions is a matter of luck, see the slow test for many."""
    cover = distances(stations, day(hall, rng, marks=120))
    assert 0.7 < cover.within <= 1
    assert cover.length.max() > 10_000


def test_the_smooth_rule_is_the_best_of_all(hall, stations, rng):
    work = day(hall, rng, marks=30)
    off = {
        r: np.mean((measure_marks(stations, work.sightings, rule=r).points[:, :2] - work.points) ** 2) for r in RULES
    }
    assert off["smooth"] <= 1.1 * min(off.values())
    assert off["bilinear"] < off["nearest"]


def test_the_budget_adds_up_to_the_covariance(hall, stations, rng):
    work = day(hall, rng, marks=2)
    found = measure_marks(stations, work.sightings)
    budget = budget_of(found, "mark01")
    assert budget.total**2 == pytest.approx(np.linalg.eigvalsh(found.covariance[0][:2, :2])[-1])
    assert set(budget.contributions) == {
        "pixels",
        "calibration",
        "survey",
        "plate",
        "repeatability",
        "mechanics between positions",
    }


def test_tables_6_3_and_6_4_are_sums_of_squares():
    laser = Budget({"survey": 3.0, "spot on the calibration mark": 3.0, "spot on the point": 3.0, "controller": 20.0})
    vision = Budget({"survey": 1.0, "view where it was at the calibration": 10.0, "pixels": 1.0})
    assert laser.total == pytest.approx(np.sqrt(3 * 9 + 400))  # "> 20 mm"
    assert vision.total == pytest.approx(np.sqrt(102))  # "ca. 10 mm"
    assert next(iter(vision.shares)) == "view where it was at the calibration"
    with pytest.raises(BadValue, match="contribution of 'x'"):
        Budget({"x": -1.0})


def test_one_known_mark_takes_a_bumped_camera_s_offset_off_everywhere(hall, stations, rng):
    """The camera was knocked: all views moved by (9, -6) mm. Away from the known mark the mechanics' doubt is left."""
    station, bump = stations["6"], Visit(np.array([9.0, -6.0]))

    def seen(name, at, p):
        q = hall.project("6", at, p[None], bump)[0]
        return Sighting.of(name, "6", at, q, sigma_px=hall.noise_px)

    first, second = station.grid[7], station.grid[6]
    known, mark = hall.view_centre("6", first), hall.view_centre("6", second)
    off = measure_marks(station, [seen("A", second, mark)]).points[0, :2] - mark
    assert off == pytest.approx([-9, 6], abs=1.0)
    again = station.recalibrated(seen("known", first, known), known, sigma_mm=0.1)
    after = measure_marks(again, [seen("A", second, mark)])
    assert (np.abs(after.points[0, :2] - mark) < 4 * after.sigma[0, :2]).all()
    assert np.abs(after.points[0, :2] - mark).max() < 1.0
    itself = measure_marks(again, [seen("known", first, known)])
    assert itself.points[0, :2] == pytest.approx(known, abs=1e-6)


@pytest.mark.parametrize("knocked", [False, True])
def test_visits_err_each_by_itself_and_take_no_memory_for_it(hall, stations, rng, knocked):
    """A mark's own visit is noise of its own; those of the calibration, and of a known mark, are what marks share."""
    station, again = stations["6"], stations["6"].repeatability.covariance
    if knocked:
        at = station.grid[6]
        known = sight(hall, "known", "6", at, hall.view_centre("6", at), rng)
        station = station.recalibrated(known, hall.view_centre("6", at), sigma_mm=0.1)
    places = [at + off for off in (0.0, np.array([150.0, 90.0])) for at in station.grid[:3]]
    seen = [sight(hall, f"m{i}", "6", at, hall.view_centre("6", at), rng) for i, at in enumerate(places)]
    found = measure_marks(station, seen)
    own = sum(part.covariance for part in found.noise if part.name == "repeatability")
    ((source, E),) = [(s, E) for s, E in found.effects if s.name == "repeatability"]
    assert E.shape[2] == 2 * (len(station.grid) + knocked)
    W = station.field.weights(np.stack(places))
    if knocked:
        W = W - station.field.weights(known.position[None])
    # by the definition: weighted visits of the calibration, the known mark's, and each mark's own
    shared = np.array([[[w @ v for v in W[b]] for w in W[a]] for a, b in ((0, 0), (0, 1), (1, 1))]) + knocked
    joint = E.reshape(18, -1) @ source.covariance @ E.reshape(18, -1).T
    for (a, b), weight in zip(((0, 0), (0, 1), (1, 1)), shared, strict=True):
        assert joint[a::3, b::3].ravel() == pytest.approx((weight * again[a, b]).ravel(), abs=1e-13 * again.max())
        assert own[:, a, b] == pytest.approx(again[a, b])
    assert (source.owner, source.dof) == (station.field, stations["6"].repeatability.dof)


def test_repeatability_is_found_from_visits(hall, stations, rng):
    """200 visits beyond the first of 10 marks, and pixels: sigma is good to 3.5 % in each axis."""
    at, seen = stations["6"].grid[3], []
    for i in range(10):
        p = hall.view_centre("6", at) + 10.0 * i
        seen += [sight(hall, f"m{i}", "6", at, p, rng) for _ in range(21)]
    found = repeatability(stations["6"], seen)
    assert found.dof == 200
    assert found.sigma == pytest.approx(np.hypot(hall.repeatability_mm, 1.25 * hall.noise_px), rel=0.15)
    with pytest.raises(TooFewPoints):
        repeatability(stations["6"], seen[:2])


def test_each_calibration_s_estimate_is_told_as_program_bilinear_did(hall, stations, rng):
    at = stations["6"].grid[:2].mean(axis=0)
    seen = sight(hall, "A", "6", at, hall.view_centre("6", at), rng)
    found = estimates(stations["6"], seen, rule="linear")
    total = sum(e.weight * e.point for e in found)
    assert total == pytest.approx(measure_marks(stations["6"], [seen], rule="linear").points[0, :2])


def test_what_cannot_be_measured_is_refused(hall, stations, rng):
    seen = sight(hall, "A", "6", stations["6"].grid[0], hall.view_centre("6", stations["6"].grid[0]), rng)
    with pytest.raises(UnknownName, match=r"camera \(it has no calibration\): '6'"):
        measure_marks(stations["12"], [seen])
    outside = Sighting.of("A", "6", [20_000.0, 20_000.0], seen.q, sigma_px=0.1)
    for rule in RULES:
        with pytest.raises(BadValue, match="extrapolation has to be asked for"):
            measure_marks(stations["6"], [outside], rule=rule)
        far = measure_marks(stations["6"], [outside], rule=rule, extrapolate=True)
        assert far.sigma[0, 0] > 1.0
    with pytest.raises(TooFewPoints):
        measure_marks(stations, [])
    with pytest.raises(BadValue, match="sigma_px"):
        Sighting.of("A", "6", [0, 0], [0, 0], sigma_px=0.0)
    with pytest.raises(BadValue, match="which is re-calibrated"):
        stations["12"].recalibrated(seen, [0, 0], sigma_mm=0.1)


def test_a_position_calibrated_twice_is_refused(stations):
    positions = stations["6"].positions
    with pytest.raises(BadValue, match="another than that of"):
        calibrate_gantry("6", [*positions, positions[0]])
    with pytest.raises(TooFewPoints):
        calibrate_gantry("6", [])


def test_one_position_alone_measures_nearby(hall, stations, rng):
    station = calibrate_gantry("6", stations["6"].positions[:1])
    at = station.grid[0]
    seen = sight(hall, "A", "6", at, hall.view_centre("6", at), rng)
    assert measure_marks(station, [seen]).points[0, :2] == pytest.approx(hall.view_centre("6", at), abs=1.5)


def test_a_day_without_a_short_distance_and_a_hall_of_nothing_are_refused(hall, stations, rng):
    with pytest.raises(TooFewPoints, match="distances up to 1 mm"):
        distances(stations, day(hall, rng, marks=4), longest_mm=1.0)
    with pytest.raises(BadValue, match="robots of the hall is none"):
        make_hall(rng, robots=())
    with pytest.raises(BadValue, match=r"vibration_mm of the hall is -0\.1"):
        make_hall(rng, vibration_mm=-0.1)


@pytest.mark.slow
def test_distances_are_within_their_stated_interval_in_93_to_97_percent():
    """Twenty halls, 24 distances a day each: the share is good to 1 % if halls are alike."""
    within = []
    for seed in range(20):
        rng = np.random.default_rng(7000 + seed)
        hall = make_hall(rng)
        stations = {n: calibrate_robot(hall, n, rng).station for n in hall.gantries}
        cover = distances(stations, day(hall, rng, marks=48))
        within += (np.abs(cover.error) <= cover.half_width).tolist()
    assert 0.93 <= np.mean(within) <= 0.97


def test_a_pixel_outside_of_the_picture_is_refused_and_one_far_from_the_plate_s_asked_for(hall, stations, rng):
    """The hall's pictures are 768 x 576 px; its stations do not know that, but where the plate's marks were seen."""
    seen = replace(day(hall, rng, marks=1).sightings[0], camera="6", position=stations["6"].grid[7])
    for q, wanted in (([5000.0, 379.0], "one near those of the plate"), ([-100.0, 379.0], "one in the picture; ")):
        with pytest.raises(BadValue, match=rf"pixel of 'mark01' is \({q[0]:.1f}, 379.0\); expected {wanted}"):
            measure_marks(stations, [replace(seen, q=np.array(q))])
    measure_marks(stations, [replace(seen, q=np.array([5000.0, 379.0]))], extrapolate=True)
    for corner in ([0.0, 0.0], [767.0, 0.0], [767.0, 575.0], [0.0, 575.0]):
        measure_marks(stations, [replace(seen, q=np.array(corner))])


def test_a_pixel_outside_of_the_lens_picture_is_refused_though_near_the_plate_s(hall, stations, rng):
    lens = Camera.from_focal((700, 500), 900)
    positions = [replace(one, lens=lens) for one in stations["6"].positions]
    station = calibrate_gantry("6", positions)
    seen = replace(day(hall, rng, marks=1).sightings[0], camera="6", position=station.grid[7], q=np.array([710.0, 9]))
    with pytest.raises(BadValue, match="expected one in the picture, which is 700 x 500 px"):
        measure_marks(station, [seen], extrapolate=True)
