"""Station files: the calibration of a camera on its gantry as JSON, with everything that it was made from.

The inputs (plate, survey, pixels, positions) and the repeatability are written; what follows from them is computed
again on reading, so that a file is always consistent.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import Any

import numpy as np

from cadcam.arrays import Array
from cadcam.camera.camera import Camera
from cadcam.errors import BadValue, UnreadableFile
from cadcam.files.camera import bare_camera_as_json, camera_at
from cadcam.files.jsontext import Place, as_json, head_as_json, parsed
from cadcam.files.text import read_text
from cadcam.station.gantry import GantryCalibration, Repeatability, Sighting, calibrate_gantry
from cadcam.station.plane import PlaneCalibration, calibrate_position
from cadcam.station.plate import Placement, Plate, place_plate
from cadcam.whole import write_whole

FORMAT = "cadcam station"
VERSION = 1


def write_station(path: str | os.PathLike[str], station: GantryCalibration) -> None:
    """Write a station file, whole or not at all."""
    write_whole(path, as_json(station_as_json(station)))


def read_station(path: str | os.PathLike[str]) -> GantryCalibration:
    """Return the calibration in a station file. Raises `UnreadableFile` naming the key."""
    place = parsed(read_text(path))
    place.check_head(FORMAT, VERSION, remedy=f"only {FORMAT!r} is read here: a file of `cadcam station calibrate`")
    plate = read_plate_in(place.at("plate"))
    lens = camera_at(place.at("lens")) if "lens" in place.object else None
    positions = [_position(one, plate, lens) for one in place.at("positions").items()]
    station = place.build(
        lambda: calibrate_gantry(place.at("camera").text(), positions, repeatability=_again(place.at("repeatability")))
    )
    if "recalibration" not in place.object:
        return station
    mark = place.at("recalibration")
    seen = _sighting(mark.at("seen"), station.camera)
    known, sigma = mark.at("known_mm").array((2,)), mark.at("sigma_mm").number()
    return mark.build(lambda: station.recalibrated(seen, known, sigma_mm=sigma))


def read_stations(paths: Sequence[str | os.PathLike[str]]) -> dict[str, GantryCalibration]:
    """Return the calibrations in station files by their camera, each camera once."""
    out: dict[str, GantryCalibration] = {}
    for path in paths:
        one = read_station(path)
        if one.camera in out:
            raise UnreadableFile(path, f"is a second calibration of camera {one.camera!r}", "give each camera one file")
        out[one.camera] = one
    if not out:
        raise BadValue("station files", "none", "one for each camera")
    return out


def read_plate(path: str | os.PathLike[str]) -> Plate:
    """Return the plate in a plate file: {"marks_mm": {"1": [0, 0], ...}, "reflectors_mm": {...}, "sigma_mm": 0.2}."""
    return read_plate_in(parsed(read_text(path)))


def write_plate(path: str | os.PathLike[str], plate: Plate) -> None:
    """Write a plate file."""
    write_whole(path, as_json(plate_as_json(plate)))


def plate_as_json(plate: Plate) -> dict[str, Any]:
    """Return a plate as written to plate and station files."""
    return {
        "marks_mm": {n: p.tolist() for n, p in zip(plate.mark_names, plate.marks, strict=True)},
        "reflectors_mm": {n: p.tolist() for n, p in zip(plate.reflector_names, plate.reflectors, strict=True)},
        "sigma_mm": plate.sigma_mm,
        **({"mark": plate.mark} if plate.mark else {}),
    }


def read_plate_in(place: Place) -> Plate:
    """Return the plate at a place of a JSON file."""
    place.only("marks_mm", "reflectors_mm", "sigma_mm", "mark")
    marks, reflectors = place.at("marks_mm"), place.at("reflectors_mm")
    sigma = place.at("sigma_mm").number() if "sigma_mm" in place.object else 0.0
    mark = place.at("mark").text() if "mark" in place.object else ""
    names = tuple(marks.object), tuple(reflectors.object)
    return place.build(lambda: Plate(_points(marks), _points(reflectors), *names, sigma, mark))


def station_as_json(station: GantryCalibration) -> dict[str, Any]:
    """Return the document that `write_station` writes."""
    again = station.repeatability
    out: dict[str, Any] = {
        **head_as_json(FORMAT, VERSION),
        "camera": station.camera,
        "plate": plate_as_json(station.positions[0].placement.plate),
        "repeatability": {"covariance_mm2": again.covariance.tolist()}
        | ({"dof": again.dof} if np.isfinite(again.dof) else {}),
        **({} if station.lens is None else {"lens": bare_camera_as_json(station.lens)}),
        "positions": [_position_as_json(one) for one in station.positions],
    }
    if (mark := station.recalibration) is not None:
        s = mark.sighting
        seen = {"name": s.name, "position_mm": s.position.tolist(), "pixel_px": s.q.tolist(), "picture": s.picture}
        seen["covariance_px2"] = s.covariance.tolist()
        out["recalibration"] = {"known_mm": mark.known.tolist(), "sigma_mm": mark.sigma_mm, "seen": seen}
    return out


def _position_as_json(one: PlaneCalibration) -> dict[str, Any]:
    fit, placement = one.estimate, one.placement
    seen = {n: q.tolist() for n, q in zip(fit.observations.names, one.pixels, strict=True)}
    names = placement.plate.reflector_names
    survey: dict[str, Any] = {n: p.tolist() for n, p in zip(names, placement.surveyed, strict=True)}
    return {
        "name": one.name,
        "position_mm": one.position.tolist(),
        "survey_mm": survey,
        **({"survey_sigma_mm": placement.sigma_mm} if np.isinf(placement.dof) else {}),
        "pixels_px": seen,
        **({} if one.sigma_px is None else {"sigma_px": one.sigma_px}),
        "source": fit.observations.source,
        "sha256": fit.observations.sha256,
    }


def _position(place: Place, plate: Plate, lens: Camera | None) -> PlaneCalibration:
    name, at = place.at("name").text(), place.at("position_mm").array((2,))
    placement = place.build(lambda: _placement(place, plate))
    seen = place.at("pixels_px")
    q = np.full((len(plate.marks), 2), np.nan)
    for mark in seen.object:
        if mark not in plate.mark_names:
            raise seen.error(f"names the mark {mark!r}", f"the plate has {', '.join(plate.mark_names)}")
        q[plate.mark_names.index(mark)] = seen.at(mark).array((2,))
    sigma = place.at("sigma_px").number() if "sigma_px" in place.object else None
    source, sha256 = place.at("source").text(), place.at("sha256").text()
    return place.build(
        lambda: calibrate_position(name, at, q, placement, sigma_px=sigma, lens=lens, source=source, sha256=sha256)
    )


def _placement(place: Place, plate: Plate) -> Placement:
    survey = place.at("survey_mm")
    survey.only(*plate.reflector_names)
    surveyed = np.stack([survey.at(name).array((2,)) for name in plate.reflector_names])
    sigma = place.at("survey_sigma_mm").number() if "survey_sigma_mm" in place.object else None
    return place_plate(plate, surveyed, sigma_mm=sigma)


def _again(place: Place) -> Repeatability:
    dof = place.at("dof").number() if "dof" in place.object else np.inf
    return Repeatability(place.at("covariance_mm2").covariance(2), dof)


def _sighting(place: Place, camera: str) -> Sighting:
    at, q = place.at("position_mm").array((2,)), place.at("pixel_px").array((2,))
    covariance, picture = place.at("covariance_px2").covariance(2), place.at("picture").text()
    return place.build(lambda: Sighting(place.at("name").text(), camera, at, q, covariance, picture))


def _points(place: Place) -> Array:
    return np.array([place.at(name).array((2,)) for name in place.object], dtype=np.float64).reshape(-1, 2)
