"""The scene file of a layout: YAML, lengths in mm, angles in degrees, as the keys say; names are free.

part: {model: block.glb}            # or just its path, relative to this file; unit: mm where the file names none
obstacles:                          # in the world
  - {model: post.stl, position_mm: [0, -2000, 0], rotation_deg: [0, 0, 0]}
poses:                              # where the part may lie in the world; default: as its file has it
  as built: {position_mm: [0, 0, 0], rotation_deg: [0, 0, 0]}      # about the world's x, then y, then z
  shifted: {position_mm: [[-20, 20], 0, 0], steps: 3}              # ranges: all combinations
cameras:                            # that can be bought, or are calibrated (file: camera.json)
  wide: {sensor: IMX304, focal_mm: 12, f_number: 8}                # focus_mm: default what it aims at
mounts:                             # where they may be
  gallery: {box_mm: [[-1000, -6000, 2000], [5000, -6000, 4000]], count: 40, aim_mm: [2000, 1500, 900]}
  robot: {arc: {center_mm: [2000, 1500, 3000], radius_mm: 6000, from_deg: 180}, count: 24, one_camera: true}
  post: {positions_mm: [[0, -6000, 1500]], aim_mm: [2000, 1500, 900], cameras: [wide], fixed: true}
features:                           # limits as in a tolerance file
  mark 1: {point_mm: [100, 200, 12], normal: [0, 0, 1], position_mm: 0.5}
  hole: {circle_mm: [400, 200, 12], normal: [0, 0, 1], diameter_mm: 40, position_mm: 0.5, direction: [1, 0, 0]}
  top edge: {edge_mm: [[0, 0, 12], [4000, 0, 12]], position_mm: 1, angle_deg: 0.05}
  stiffener: {part: bar 1.1 port, kinds: [crease], position_mm: 1}
  on the floor: {point_mm: [500, 0, 0], normal: [0, 0, 1], known_plane_mm: 0.2, position_mm: 1}
datum: [{part: tank top}]           # what `part` features are judged from, as by `cadcam verify`; default: the world
noise: {sigma_px: 0.05}             # and/or gray: 0.01, contrast: 0.4 (white = 1); floor_px; blur_px: 0.6
calibration: {points: 30, sigma_px: 0.1, points_mm: 0.05}   # of each camera, from points over picture and depth;
#            or independent sigmas: {position_mm: 0.2, rotation_deg: 0.002, focal_px: 0.3, principal_point_px: 0.3}
motion: {position_mm: 0.1, rotation_deg: 0.005}     # of cameras on mounts with one_camera: true
placement: {position_mm: 0.5, rotation_deg: 0.01}   # of the part, for features on known planes
seen: {incidence_deg: 70, blur_px: 4, border_px: 4, least_px: 6, share: 0.6}
k: 2                                # coverage factor of U = k sigma
rule: guard band                    # ISO 14253-1; or: simple acceptance
tur: 3                              # limit/U that every limit should reach
choose: 4                           # cameras to choose beside the fixed ones
"""

from __future__ import annotations

import os
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cadcam.arrays import Array
from cadcam.cad.mesh import Mesh, merge
from cadcam.errors import UnknownName
from cadcam.files.jsontext import Place
from cadcam.files.text import read_text
from cadcam.files.yamltext import parsed_yaml
from cadcam.geometry.rigid import Rigid
from cadcam.geometry.rotation import exp
from cadcam.plan.scene.asked import features_at, judged_from
from cadcam.plan.scene.idle import refuse_idle
from cadcam.plan.scene.layout_scene import CalibratedFrom, CameraType, LayoutScene, Mount, Seeing, Sigmas
from cadcam.plan.scene.zones import arc, in_box
from cadcam.plan.uncertainty.finding import Finder

if TYPE_CHECKING:
    from cadcam.files.camera import CameraFile

_TOP = (
    "part", "obstacles", "poses", "cameras", "mounts", "features", "noise", "calibration", "motion", "placement",
    "seen", "k", "rule", "tur", "choose", "datum",
)  # fmt: skip
_MODEL = ("model", "unit", "tolerance_mm")
_POSE = ("position_mm", "rotation_deg")
_CAMERA = ("file", "sensor", "pixels", "focal_mm", "f_number", "focus_mm", "image_circle_mm")
_PLACES = ("positions_mm", "box_mm", "arc")
_MOUNT = (*_PLACES, "count", "aim_mm", "up", "cameras", "fixed", "one_camera")
_ARC = ("center_mm", "radius_mm", "from_deg", "to_deg", "axis")
_SIGMAS = ("position_mm", "rotation_deg", "focal_px", "principal_point_px")
_MOST_POSES = 400
Sources = list[tuple[str, str, str]]


def read_layout_scene(path: str | os.PathLike[str]) -> LayoutScene:
    """Return the scene in a file (layout: see this module); paths in it are relative to it.

    Raises `UnreadableFile` naming the key that is wrong and what is known, and as the models' and cameras' readers.
    """
    file = read_text(path)
    place = parsed_yaml(file)
    place.only(*_TOP)
    folder = Path(file.path).parent
    sources: Sources = [("scene", file.path, file.sha256)]
    part = _model(place.at("part"), folder, sources, "part")
    poses = _poses(place.at("poses")) if "poses" in place.object else {"as it is": Rigid()}
    read: dict[str, CameraFile] = {}
    cameras = {
        name: _camera(place.at("cameras").at(name), folder, name, sources, read) for name in place.at("cameras").object
    }
    world = next(iter(poses.values()))
    middle = world @ part.bounds.mean(axis=0)
    mounts = tuple(_mount(place.at("mounts").at(name), name, cameras, middle) for name in place.at("mounts").object)
    scene = place.build(
        lambda: LayoutScene(
            part=part,
            poses=poses,
            cameras=cameras,
            mounts=mounts,
            features=features_at(place, part),
            finder=_finder(place.at("noise")),
            obstacles=_obstacles(place, folder, sources),
            calibration=_calibration(place),
            motion=_sigmas(place, "motion", _SIGMAS[:2]),
            placement=_sigmas(place, "placement", _SIGMAS[:2]),
            seeing=_seeing(place),
            tur=_number(place, "tur", 3.0),
            choose=_whole(place, "choose", 4),
            datum=judged_from(place, part),
            name=Path(file.path).stem,
            sources=tuple(sources),
        )
    )
    refuse_idle(place, scene)
    return scene


def _model(place: Place, folder: Path, sources: Sources, role: str, *more: str) -> Mesh:
    from cadcam.cad.read import read_model_with_report

    given = place.value if isinstance(place.value, dict) else {"model": place.value}
    place = Place(place.path, place.keys, given)
    place.only(*_MODEL, *more)
    unit = place.at("unit").text() if "unit" in given else None
    chordal = place.at("tolerance_mm").number() if "tolerance_mm" in given else None
    path = folder / place.at("model").text()
    mesh, report = place.build(lambda: read_model_with_report(path, unit=unit, chordal_tolerance_mm=chordal))
    sources.append((role, str(path), report.sha256))
    return mesh


def _obstacles(place: Place, folder: Path, sources: Sources) -> Mesh | None:
    if "obstacles" not in place.object:
        return None
    items = place.at("obstacles").items("write '- {model: post.stl}' lines")
    placed = [_model(item, folder, sources, "obstacle", *_POSE).transformed(_pose(item)) for item in items]
    return merge(placed) if placed else None


def _poses(place: Place) -> dict[str, Rigid]:
    out: dict[str, Rigid] = {}
    for name in place.object:
        entry = place.at(name)
        entry.only(*_POSE, "steps")
        sets = _combinations(entry)
        for i, (position, turn) in enumerate(sets, 1):
            one = name if len(sets) == 1 else f"{name} {i}"
            if one in out:
                raise entry.error(f"makes a second pose {one!r}", "rename one: ranges make numbered poses")
            out[one] = Rigid(_turned(turn), position)
    if not out:
        raise place.error(
            "names no pose", "write name: {position_mm: [x, y, z], rotation_deg: [a, b, c]}, or leave it out"
        )
    if len(out) > _MOST_POSES:
        raise place.error(f"makes {len(out)} poses", f"at most {_MOST_POSES}: fewer ranges, or fewer steps")
    return out


def _combinations(entry: Place) -> list[tuple[Array, Array]]:
    """Return all (position, rotation in deg) of an entry whose numbers may be ranges [low, high]."""
    steps = _whole(entry, "steps", 3)
    if steps < 2:
        raise entry.error(f"has steps: {steps}", "at least 2, the ends of each range")
    axes: list[Array] = []
    for key in _POSE:
        if key not in entry.object:
            axes += [np.zeros(1)] * 3
            continue
        place = entry.at(key)
        if not isinstance(place.value, list) or len(place.value) != 3:
            raise place.error("is no list of three", "numbers, or ranges [low, high]")
        for one in place.items():
            axes.append(_range(one, steps) if isinstance(one.value, list) else one.array(())[None])
    if "steps" in entry.object and all(len(a) == 1 for a in axes):
        raise entry.error("has steps without a range", "write a number as [low, high], or leave steps out")
    if np.prod([len(a) for a in axes]) > _MOST_POSES:
        raise entry.error("has too many combinations", f"at most {_MOST_POSES}: fewer ranges, or steps: 2")
    return [(np.array(v[:3]), np.array(v[3:])) for v in product(*axes)]


def _range(place: Place, steps: int) -> Array:
    low, high = place.array((2,)).tolist()
    return np.linspace(low, high, steps)


def _pose(place: Place) -> Rigid:
    position = place.at("position_mm").array((3,)) if "position_mm" in place.object else np.zeros(3)
    turn = place.at("rotation_deg").array((3,)) if "rotation_deg" in place.object else np.zeros(3)
    return Rigid(_turned(turn), position)


def _turned(degrees: Array) -> Array:
    """Return the rotation about the world's x, then y, then z."""
    x, y, z = np.diag(np.radians(degrees))
    return np.asarray(exp(z) @ exp(y) @ exp(x))


def _camera(place: Place, folder: Path, name: str, sources: Sources, read: dict[str, CameraFile]) -> CameraType:
    """Return a camera; read: camera files by content, since one that is given twice is one calibration."""
    from cadcam.camera.sensor_format import sensor_format
    from cadcam.files.camera import read_camera

    place.only(*_CAMERA)
    given = place.object
    numbers: dict[str, Any] = {key: place.at(key).number() for key in _CAMERA[3:] if key in given}
    sensor = place.build(lambda: sensor_format(_word(place.at("sensor")))) if "sensor" in given else None
    if "pixels" in given:
        if sensor is None:
            raise place.error("has pixels without a sensor", "give sensor too, or leave pixels out")
        sensor = sensor.with_pixels(_pixels(place.at("pixels")))
    if "file" not in given:
        return place.build(lambda: CameraType(name, sensor, **numbers))
    path = folder / place.at("file").text()
    content = read_text(path).sha256
    file = read.setdefault(content, read_camera(path))
    sources.append(("camera", str(path), content))
    if sensor is not None and sensor.pixels is None:
        sensor = sensor.with_pixels(file.camera.size)
    own = file.estimate
    stated = None if own is None or own.pose_alone else own  # found with this camera, a pose says nothing of it
    return place.build(lambda: CameraType(name, sensor, own=file.camera, estimate=stated, **numbers))


def _pixels(place: Place) -> tuple[int, int]:
    given = place.array((2,))
    if (given != np.floor(given)).any():
        raise place.error(f"is {given.tolist()}", "two whole numbers, columns and rows, are expected")
    return int(given[0]), int(given[1])


def _word(place: Place) -> str:
    """Return a text; a size such as 1/2 or a bare 1 is one too."""
    return f"{place.value:g}" if isinstance(place.value, float) else place.text()


def _mount(place: Place, name: str, cameras: dict[str, CameraType], middle: Array) -> Mount:
    place.only(*_MOUNT)
    given = place.object
    kinds = place.at("cameras").texts() if "cameras" in given else tuple(cameras)
    for kind in kinds:
        if kind not in cameras:
            raise place.at("cameras").error(f"names an {UnknownName('camera', kind, cameras)}")
    eyes = _eyes(place)
    aims = _aims(place.at("aim_mm")) if "aim_mm" in given else middle[None]
    up = place.at("up").array((3,)) if "up" in given else np.array([0.0, 0.0, 1.0])
    return place.build(
        lambda: Mount(
            name,
            np.repeat(eyes, len(aims), axis=0),
            np.tile(aims, (len(eyes), 1)),
            kinds,
            (float(up[0]), float(up[1]), float(up[2])),
            fixed=_flag(place, "fixed"),
            one_camera=_flag(place, "one_camera"),
            spread="positions_mm" not in given,
        )
    )


def _eyes(place: Place) -> Array:
    given = place.object
    said = [key for key in _PLACES if key in given]
    if len(said) != 1:
        raise place.error(f"has {' and '.join(said) or 'no place'}", f"give one of {', '.join(_PLACES)}")
    if said[0] == "positions_mm":
        if "count" in given:
            raise place.error("has count beside positions_mm", "leave it out: each position is a candidate")
        return place.at("positions_mm").array((None, 3))
    count = _whole(place, "count", 20)
    if said[0] == "box_mm":
        box = place.at("box_mm").array((2, 3))
        return place.build(lambda: in_box(box, count))
    zone = place.at("arc")
    zone.only(*_ARC)
    numbers = {key: zone.at(key).number() for key in _ARC[1:4] if key in zone.object}
    axis = zone.at("axis").array((3,)) if "axis" in zone.object else np.array([0.0, 0.0, 1.0])
    radius = zone.at("radius_mm").number()
    start, end = numbers.get("from_deg", 0.0), numbers.get("to_deg", 360.0)
    return zone.build(lambda: arc(zone.at("center_mm").array((3,)), radius, start, end, count, axis=axis))


def _aims(place: Place) -> Array:
    several = isinstance(place.value, list) and any(isinstance(v, list) for v in place.value)
    aims = place.array((None, 3)) if several else place.array((3,))[None]
    if not len(aims):
        raise place.error("names no place", "write [x, y, z], or a list of them")
    return aims


def _finder(place: Place) -> Finder:
    names = ("sigma_px", "gray", "contrast", "floor_px", "blur_px")
    place.only(*names)
    return place.build(lambda: Finder(**{name: place.at(name).number() for name in names if name in place.object}))


def _sigmas(place: Place, key: str, known: tuple[str, ...]) -> Sigmas:
    if key not in place.object:
        return Sigmas()
    at = place.at(key)
    at.only(*known)
    numbers = {name: at.at(name).number() for name in known if name in at.object}
    turn = float(np.radians(numbers.pop("rotation_deg", 0.0)))
    return at.build(lambda: Sigmas(rotation=turn, **numbers))


def _calibration(place: Place) -> Sigmas | CalibratedFrom:
    if "calibration" not in place.object or "points" not in place.at("calibration").object:
        return _sigmas(place, "calibration", _SIGMAS)
    at = place.at("calibration")
    at.only("points", "sigma_px", "points_mm")
    names = ("sigma_px", "points_mm")
    numbers = {name: at.at(name).number() for name in names if name in at.object}
    return at.build(lambda: CalibratedFrom(_whole(at, "points", 0), **numbers))


def _seeing(place: Place) -> Seeing:
    if "seen" not in place.object:
        return Seeing()
    at = place.at("seen")
    at.only("incidence_deg", "blur_px", "border_px", "least_px", "share")
    numbers = {name: at.at(name).number() for name in at.object}
    if "incidence_deg" in numbers:
        numbers["incidence"] = float(np.radians(numbers.pop("incidence_deg")))
    return at.build(lambda: Seeing(**numbers))


def _number(place: Place, key: str, default: float) -> float:
    return place.at(key).number() if key in place.object else default


def _whole(place: Place, key: str, default: int) -> int:
    value = place.at(key).whole() if key in place.object else default
    if value < 0:
        raise place.at(key).error(f"is {value}", "a whole number from 0 on is expected")
    return value


def _flag(place: Place, key: str) -> bool:
    return key in place.object and place.at(key).flag()
