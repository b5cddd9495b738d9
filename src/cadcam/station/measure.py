"""Marks measured by calibrated gantries: where they are, and everything that their uncertainty consists of.

Each calibration i around the camera's position gives an estimate p_i = H_i^-1 q + position; their weighted mean is the
point (6.4.3.5). Marks measured with one calibration, survey, plate or gantry share its errors. The `Measurement` keeps
these shared effects, so that they cancel in distances where they should.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from cadcam.arrays import Array
from cadcam.camera.error_source import ErrorSource
from cadcam.camera.measurement import Measurement, PixelNoise
from cadcam.errors import BadValue, DegenerateGeometry, TooFewPoints
from cadcam.kinds import expect, expect_by_name, expect_each, expect_flag, expect_known, expect_positive
from cadcam.station.cross_prediction import plate_effect
from cadcam.station.gantry import GantryCalibration, Repeatability, Sighting
from cadcam.station.interpolation import NEAR_MM, RULES, Rule, check_inside, weights
from cadcam.station.plane import PlaneCalibration
from cadcam.station.plate import Plate

CALIBRATION, SURVEY, PLATE = "calibration", "survey", "plate"
REPEATABILITY, MECHANICS, KNOWN_MARK = "repeatability", "mechanics between positions", "re-calibration mark"


@dataclass(frozen=True, slots=True, eq=False)
class PointEstimate:
    """One calibration's share in a measurement: its position, the point (2,) it estimates, its weights in x and y."""

    name: str
    position: Array
    point: Array
    weight: Array


def measure_marks(
    stations: Mapping[str, GantryCalibration] | GantryCalibration,
    sightings: Sequence[Sighting],
    *,
    rule: Rule = "smooth",
    extrapolate: bool = False,
    near_mm: float = NEAR_MM,
) -> Measurement:
    """Return the marks' points (N, 3) mm in the survey's world, Z = 0, with every cause of their uncertainty.

    rule: "smooth", the weights with the least predicted error (`DeviationField`), or those of
    `station.interpolation.weights`. Raises `UnknownName` for a camera without a calibration, `BadValue` for a position
    outside of the calibrated ones or a pixel far from all that the plate's marks were seen at, unless `extrapolate`,
    and for a pixel outside of the picture; `DegenerateGeometry` for one that does not show the floor.
    """
    expect(stations, "stations", GantryCalibration, Mapping)
    known = {stations.camera: stations} if isinstance(stations, GantryCalibration) else stations
    expect_by_name(known, "stations", GantryCalibration)
    sightings = expect_each(sightings, "sightings", Sighting)
    expect_positive(near_mm, "near_mm", "a number of mm from 0 on", zero=True)
    expect_flag(extrapolate, "extrapolate")
    expect_known(rule, "rule", RULES)
    if not sightings:
        raise TooFewPoints("measuring", 0, 1, of="marks")
    for sighting in sightings:
        expect_known(sighting.camera, "camera (it has no calibration):", known)
        known[sighting.camera].check_pixel(sighting, extrapolate=extrapolate)
    index: list[int] = []
    parts: list[_CameraPoints] = []
    visits: list[PixelNoise] = []
    for camera in dict.fromkeys(s.camera for s in sightings):
        own = [i for i, s in enumerate(sightings) if s.camera == camera]
        index += own
        seen = [sightings[i] for i in own]
        found = _measured(known[camera], seen, _Interpolation(rule, extrapolate, near_mm))
        part, visit = _with_visits(known[camera], found)
        parts.append(part)
        if visit is not None:
            visits.append(replace(visit, covariance=_placed(visit.covariance, own, len(sightings))))
    return _joined(parts, visits, index, sightings, rule)


def estimates(
    station: GantryCalibration, sighting: Sighting, *, rule: Rule = "smooth", extrapolate: bool = False
) -> tuple[PointEstimate, ...]:
    """Return each calibration's estimate of a sighting and its weight, largest first, as Prog 6 lists them."""
    W = _weights(station, [sighting], _Interpolation(rule, extrapolate, NEAR_MM))[:, 0]
    order = np.argsort(-np.abs(W).sum(axis=0))
    return tuple(
        PointEstimate(
            one.name, one.position, one.predict(one.straight(sighting.q[None]), sighting.position)[0], W[:, i]
        )
        for i in order
        for one in (station.positions[i],)
        if np.any(W[:, i] != 0)
    )


def repeatability(station: GantryCalibration, sightings: Iterable[Sighting]) -> Repeatability:
    """Return how well the camera returns to a position, from marks each seen on several visits, grouped by name.

    The pooled scatter of each mark's visits about their mean, which includes pixel noise. Marks must not move.
    Raises `TooFewPoints` below two visits more than marks.
    """
    groups: dict[str, list[Array]] = {}
    for s in sightings:
        nearest = station.positions[int(np.argmin(np.linalg.norm(station.grid - s.position, axis=1)))]
        groups.setdefault(s.name, []).append(nearest.predict(nearest.straight(s.q[None]), s.position)[0])
    visits = [np.stack(points) for points in groups.values()]
    dof = sum(len(points) - 1 for points in visits)
    if dof < 2:
        raise TooFewPoints("repeatability", dof, 2, of="visits beyond the first of each mark")
    scatter = [(points - points.mean(axis=0)).T @ (points - points.mean(axis=0)) for points in visits]
    return Repeatability(np.sum(scatter, axis=0) / dof, float(dof))


@dataclass(frozen=True, slots=True)
class _Interpolation:
    """How calibrations are weighted: by which rule, whether beyond their positions, and how near is near (mm)."""

    rule: Rule
    extrapolate: bool
    near_mm: float


@dataclass(frozen=True, slots=True, eq=False)
class _CameraPoints:
    """Points (n, 2) of one camera, their pixels' covariance (n, 2, 2), and effects (n, 2, k) of the shared sources.

    visits (n, 2, m, 2): effects of the errors of m visits that points share; besides these each has one of its own.
    """

    points: Array
    pixels: Array
    effects: list[tuple[ErrorSource, Array]]
    visits: Array


def _measured(station: GantryCalibration, seen: Sequence[Sighting], how: _Interpolation) -> _CameraPoints:
    """Return the camera's points, with the error at the re-calibration's mark subtracted."""
    if station.recalibration is None:
        return _raw(station, seen, how)
    mark = station.recalibration
    raw = _raw(station, [mark.sighting, *seen], how)
    effects = [(source, E[1:] - E[:1]) for source, E in raw.effects]
    pixels = ErrorSource(KNOWN_MARK, raw.pixels[0], mark.sighting)
    place = ErrorSource(KNOWN_MARK, mark.sigma_mm**2 * np.eye(2), mark)
    both = np.broadcast_to(np.eye(2), (len(seen), 2, 2))
    return _CameraPoints(
        raw.points[1:] - (raw.points[0] - mark.known),
        raw.pixels[1:],
        [*effects, (pixels, -both), (place, both)],
        np.concatenate([raw.visits[1:] - raw.visits[:1], both[:, :, None]], axis=2),  # the mark's visit moves all
    )


def _raw(station: GantryCalibration, seen: Sequence[Sighting], how: _Interpolation) -> _CameraPoints:
    """Return the camera's points as its calibrations have them: the weighted means of their estimates."""
    W = _weights(station, seen, how)
    n, q, at = len(seen), np.stack([s.q for s in seen]), np.stack([s.position for s in seen])
    points, by_pixel = np.zeros((n, 2)), np.zeros((n, 2, 2))
    effects: list[tuple[ErrorSource, Array]] = []
    plates: dict[int, tuple[ErrorSource, Array]] = {}
    for i, one in enumerate(station.positions):
        share = W[:, :, i].T  # (n, 2)
        if not share.any():
            continue
        p = _relative(one, one.straight(q), seen)
        back, by_entry = one.by_entries(p)
        points += share * (p + at)
        by_pixel += share[:, :, None] * back
        effects += _of_position(one, share[:, :, None], by_entry, p)
        _add_plate(plates, one, share[:, :, None] * plate_effect(one, by_entry, p + one.position))
    if station.lens is not None:  # the covariances are those of the pixels as found
        by_pixel = by_pixel @ station.lens.undistorted_with_jacobian(q)[1]
    noise = by_pixel @ np.stack([s.covariance for s in seen]) @ np.swapaxes(by_pixel, 1, 2)
    visits = np.zeros((n, 2, W.shape[2], 2))
    for axis in (0, 1):
        visits[:, axis, :, axis] = W[axis]
    return _CameraPoints(points, noise, [*effects, *plates.values(), *_of_mechanics(station, at, W)], visits)


def _relative(one: PlaneCalibration, q: Array, seen: Sequence[Sighting]) -> Array:
    p = one.camera.unproject(q)
    blind = ~np.isfinite(p).all(axis=1)
    if blind.any():
        which = seen[int(np.argmax(blind))]
        raise DegenerateGeometry(f"the pixel of {which.name!r}, {which.q.tolist()}, does not show the floor")
    return p


def _of_position(one: PlaneCalibration, share: Array, by_entry: Array, p: Array) -> list[tuple[ErrorSource, Array]]:
    """Return the effects of one calibration's pixels and survey on the points."""
    fit, placement = one.estimate, one.placement
    if not np.isfinite(fit.noise_px):
        raise BadValue(
            f"pixel noise of the calibration {one.name}", "unknown (four marks only)", "more marks, or sigma_px with it"
        )
    dof = float(fit.dof) if fit.stated_px is None else np.inf
    pixels = ErrorSource(CALIBRATION, fit.covariance, fit, dof)
    survey = ErrorSource(SURVEY, placement.covariance, placement, placement.dof)
    return [(pixels, share * by_entry), (survey, share * placement.moves(p + one.position))]


def _add_plate(plates: dict[int, tuple[ErrorSource, Array]], one: PlaneCalibration, effect: Array) -> None:
    """Add the effects of the plate's errors on the points: it is the same plate at all positions."""
    plate = one.placement.plate
    if plate.sigma_mm == 0:
        return
    if id(plate) in plates:
        source, before = plates[id(plate)]
        plates[id(plate)] = source, before + effect
    else:
        plates[id(plate)] = ErrorSource(PLATE, plate.sigma_mm**2 * np.eye(effect.shape[-1]), plate), effect


def _of_mechanics(station: GantryCalibration, at: Array, W: Array) -> list[tuple[ErrorSource, Array]]:
    """Return the effects on the points of the mechanics between the positions."""
    n, out = len(at), []
    between = station.field.error_covariance(at, W)
    for axis in (0, 1):
        effect = np.zeros((n, 2, n))
        effect[range(n), axis, range(n)] = 1.0
        out.append((ErrorSource(MECHANICS, between[axis], station.field.hypotheses[axis]), effect))
    return out


def _with_visits(station: GantryCalibration, found: _CameraPoints) -> tuple[_CameraPoints, PixelNoise | None]:
    """Return the points with the effect of the visits that they share, and the error of each one's own visit."""
    again, (n, _, m, _) = station.repeatability, found.visits.shape
    if not again.covariance.any():
        return found, None
    covariance = np.asarray(np.kron(np.eye(m), again.covariance), dtype=np.float64)
    shared = ErrorSource(REPEATABILITY, covariance, station.field, again.dof), found.visits.reshape(n, 2, -1)
    own = PixelNoise(np.broadcast_to(again.covariance, (n, 2, 2)), station.field, again.dof, REPEATABILITY)
    return replace(found, effects=[*found.effects, shared]), own


def _weights(station: GantryCalibration, seen: Sequence[Sighting], how: _Interpolation) -> Array:
    """Return the weights (2, n, N), for x and y, of the calibrations in each sighting."""
    grid, at = station.grid, np.stack([s.position for s in seen])
    if how.rule == "smooth":
        for place in at:
            check_inside(grid, place, extrapolate=how.extrapolate, near_mm=how.near_mm)
        return station.field.weights(at)
    near, beyond = how.near_mm, how.extrapolate
    each = np.stack([weights(grid, place, how.rule, extrapolate=beyond, near_mm=near) for place in at])
    return np.stack([each, each])


def _joined(
    parts: Sequence[_CameraPoints],
    visits: Sequence[PixelNoise],
    index: Sequence[int],
    sightings: Sequence[Sighting],
    rule: Rule,
) -> Measurement:
    """Return all cameras' points in the order of the sightings; index: the sighting of each point, part by part."""
    n = len(sightings)
    points = np.zeros((n, 3))
    points[list(index), :2] = np.concatenate([part.points for part in parts])
    pixels = _placed(np.concatenate([part.pixels for part in parts]), index, n)
    nothing = np.full(n, np.nan)
    return Measurement(
        names=tuple(s.name for s in sightings),
        points=points,
        noise=(PixelNoise(pixels), *visits),
        effects=_merged_effects(parts, index),
        seen_by=tuple((s.camera,) for s in sightings),
        chi2=np.zeros(n),
        dof=np.zeros(n, dtype=np.int32),
        gap=nothing,
        gap_sigma=nothing,
        angle=nothing,
        method=f"gantry, {rule}",
    )


def _placed(covariance: Array, rows: Sequence[int], n: int) -> Array:
    """Return covariances (n, 3, 3) of all points from those (m, 2, 2) on the floor of some of them; else zero."""
    out = np.zeros((n, 3, 3))
    out[list(rows), :2, :2] = covariance
    return out


def _merged_effects(parts: Sequence[_CameraPoints], index: Sequence[int]) -> tuple[tuple[ErrorSource, Array], ...]:
    """Return the effects (n, 3, k) of every error source on all n points, those of one owner added up.

    Cameras may share a source: a plate is the same whichever station file it was read from.
    """
    n = len(index)
    merged: dict[int | bytes, tuple[ErrorSource, Array]] = {}
    first = 0
    for part in parts:
        rows = list(index[first : first + len(part.points)])
        first += len(part.points)
        for source, effect in part.effects:
            whole = np.zeros((n, 3, effect.shape[-1]))
            whole[rows, :2] = effect
            key = source.owner.key if isinstance(source.owner, Plate) else id(source.owner)
            before = merged.get(key)
            merged[key] = (source, whole if before is None else before[1] + whole)
    return tuple(merged.values())
