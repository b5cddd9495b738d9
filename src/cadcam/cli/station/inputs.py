"""The inputs of `cadcam station`: pictures with their positions, marks found in them or listed."""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from cadcam.cli.arguments import numbers, refuse
from cadcam.cli.whites import white_as_asked
from cadcam.errors import BadValue, UnreadableFile

if TYPE_CHECKING:
    from collections.abc import Mapping

    from cadcam.arrays import Array, Picture
    from cadcam.files.pixels import ListedPixels
    from cadcam.files.shot import ShotPosition
    from cadcam.station.gantry import GantryCalibration, Sighting
    from cadcam.station.marks import MarkLook
    from cadcam.station.plate import Plate


@dataclass(frozen=True, slots=True, eq=False)
class PictureSource:
    """Pictures, or listed pixels instead, and the positions of both; white: as `white_as_asked` gives it."""

    pictures: tuple[str, ...]
    pixels: ListedPixels | None
    positions: Mapping[str, ShotPosition] | None
    positions_from: str
    white: float | None = None

    def shot(self, picture: str) -> ShotPosition:
        """Return position and time of a picture."""
        from cadcam.files.shot import read_shot

        if self.pixels is None or Path(picture).is_file():
            return read_shot(picture, self.positions, positions_from=self.positions_from)
        listed = (self.positions or {}).get(Path(picture).name)
        if listed is None:
            where = self.positions_from or "--positions"
            raise UnreadableFile(where, f"has no position of {picture!r}", "add a line for it, or name the picture")
        return listed


def source(arguments: argparse.Namespace) -> PictureSource:
    """Return the inputs given on the command line."""
    from cadcam.cli.photos import picture_files
    from cadcam.files.pixels import read_pixels
    from cadcam.files.shot import read_positions

    positions = read_positions(arguments.positions) if arguments.positions else None
    if arguments.pixels:
        pixels = read_pixels(arguments.pixels)
        if arguments.pictures:
            raise BadValue("--pixels", "given beside pictures", "one of the two")
        found = "pictures in its place: listed marks are found already"
        refuse(arguments, "--mark", "--radius", "--full-scale", why="beside --pixels", expected=found)
        return PictureSource(pixels.views, pixels, positions, arguments.positions or "")
    if not arguments.pictures:
        raise BadValue("pictures", "none given", "pictures, or --pixels FILE with the marks in them")
    pictures = picture_files(arguments.pictures)
    white = white_as_asked(arguments, pictures)
    return PictureSource(tuple(pictures), None, positions, arguments.positions or "", white)


def look_of(arguments: argparse.Namespace, plate: Plate, radius_px: float | None) -> MarkLook:
    """Return the geometry of the marks, by --mark and --radius, else by the plate file and its known size."""
    from cadcam.station.marks import MarkLook
    from cadcam.target.marks.mark import parse_mark

    text = arguments.mark or plate.mark
    if not text:
        raise BadValue(
            "--mark", "not given, and the plate file has no 'mark'", "a mark such as dot-ring:40mm:80mm:120mm"
        )
    if not arguments.radius:
        return MarkLook(parse_mark(text), radius_px)
    radii = numbers("--radius", arguments.radius)
    if len(radii) > 2 or min(radii) <= 0:
        raise BadValue("--radius", repr(arguments.radius), "one radius in px, or the least and the largest")
    return MarkLook(parse_mark(text), radii[0] if len(radii) == 1 else (radii[0], radii[1]))


def sightings(
    arguments: argparse.Namespace, stations: Mapping[str, GantryCalibration]
) -> tuple[list[Sighting], list[ShotPosition]]:
    """Return the marks of the pictures, or of --pixels, and the positions and times of their observation."""
    given = source(arguments)
    found = []
    shots = []
    for picture in given.pictures:
        shot = given.shot(picture)
        station = _station_of(picture, shot, stations)
        if given.pixels is None:
            found.append(_in_picture(arguments, picture, given.white, shot, station))
            shots.append(shot)
            continue
        for name, q in _listed(given.pixels, picture):
            found.append(_sighting(name, station.camera, shot, q, _sigma(arguments, station), picture))
            shots.append(shot)
    return found, shots


def gray_picture(path: str, white: float | None) -> tuple[Picture, str]:
    """Return the grey picture in a file and the hash of the file; white: as `white_as_asked` gives it."""
    from cadcam.image.camera_picture import read_camera_picture_with_info
    from cadcam.image.picture import to_gray

    picture, info = read_camera_picture_with_info(path, full_scale=white)
    return to_gray(picture), info.sha256


def _station_of(picture: str, shot: ShotPosition, stations: Mapping[str, GantryCalibration]) -> GantryCalibration:
    from cadcam.errors import UnknownName

    if not shot.camera:
        if len(stations) == 1:
            return next(iter(stations.values()))
        raise UnreadableFile(picture, "does not say which camera took it", f"cameras are {', '.join(sorted(stations))}")
    if shot.camera not in stations:
        raise UnknownName(f"camera of {picture} (it has no calibration):", shot.camera, stations)
    return stations[shot.camera]


def _in_picture(
    arguments: argparse.Namespace, picture: str, white: float | None, shot: ShotPosition, station: GantryCalibration
) -> Sighting:
    from cadcam.station.gantry import Sighting
    from cadcam.station.marks import find_mark

    plate = station.positions[0].placement.plate
    look = look_of(arguments, plate, None)
    if look.radius_px is None:
        look = replace(look, radius_px=station.radius_px(look.mark.radius))
    gray, _ = gray_picture(picture, white)
    try:
        q, covariance = find_mark(gray, look, lens=station.lens)
    except BadValue as error:
        raise UnreadableFile(picture, str(error)) from error
    name = Path(picture).stem
    if arguments.sigma is not None:
        return _sighting(name, station.camera, shot, q, arguments.sigma, picture)
    return Sighting(name, station.camera, _at(shot), q, covariance, picture)


def _sighting(name: str, camera: str, shot: ShotPosition, q: Array, sigma_px: float, picture: str) -> Sighting:
    from cadcam.station.gantry import Sighting

    return Sighting.of(name, camera, _at(shot), q, sigma_px=sigma_px, picture=picture)


def _sigma(arguments: argparse.Namespace, station: GantryCalibration) -> float:
    return station.sigma_px if arguments.sigma is None else float(arguments.sigma)


def _listed(pixels: ListedPixels, view: str) -> list[tuple[str, Array]]:
    import numpy as np

    row = pixels.q[pixels.views.index(view)]
    return [(name, q) for name, q in zip(pixels.names, row, strict=True) if np.isfinite(q).all()]


def _at(shot: ShotPosition) -> Array:
    import numpy as np

    return np.array([shot.x, shot.y])
