"""The cases of benchmarks/locate_battery.py: conditions, and the random choices of each seed."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path

import numpy as np

from battery_conditions import CONDITIONS, DARK, NIST, OWN, Condition
from battery_pictures import Stage, Surface, by_pyrender, radiance
from battery_wrong import beside, flange, rack
from cadcam.arrays import Array, Longs, Picture
from cadcam.cad.mesh import Mesh
from cadcam.cad.parts import calibration_bench, machined_bracket, ship_block
from cadcam.cad.parts.shape import box, circle, prism, tube
from cadcam.cad.read import read_model
from cadcam.camera.camera import Camera
from cadcam.geometry.rigid import Rigid
from cadcam.geometry.rotation import exp
from cadcam.image.picture import read_picture, to_gray, write_picture
from cadcam.locate.part import Part
from cadcam.locate.views.view_range import ViewRange
from cadcam.render.light import Lamp
from quality import ALIKE, its_own_mirror_image, least_px, visible_corners

WHITE = 0.9  # of the brightest hundredth of a picture


def step_block() -> Mesh:
    """Return a stepped and bevelled block of few edges."""
    outline = np.array([(0, 0), (90, 0), (90, 22), (52, 22), (40, 48), (0, 48)], float)
    return prism(outline, 0, 38, name="block")


PARTS: dict[str, Callable[[], Mesh]] = {
    "bracket": partial(machined_bracket, sides=96),
    "ship block": partial(ship_block, triangles=8000, size=(2400.0, 2000.0, 1200.0)),
    "bench": calibration_bench,
    "flange": flange,
    "step block": step_block,
}


@dataclass(frozen=True)
class Case:
    """A part before a camera: where it is, what else stands there, and the starts."""

    name: str
    condition: Condition
    part: Part
    camera: Camera
    truth: Rigid
    world_from_part: Rigid
    stage: Stage
    starts: Sequence[Rigid | None]
    views: ViewRange
    seed: Sequence[int]
    told: Camera  # which `locate` is given
    truths: Sequence[Rigid]  # of parts of a kind, any of which may be found
    places: Array  # (V, 3): where the model's corners are on the part that is photographed
    corners: Longs  # which of them are compared
    possible: bool  # whether some pose of the model before the camera told shows what the picture does


@cache
def mesh_of(name: str, data: Path | None, fine: bool) -> Mesh:
    """Return a part; fine: as it is photographed, rounder than its model."""
    if name == "rack":
        return rack()
    if name in PARTS:
        return machined_bracket(sides=384) if fine and name == "bracket" else PARTS[name]()
    assert data is not None
    return read_model(data / "cad_nist_ctc" / f"{name}_asme1_ap203.stp", chordal_tolerance_mm=0.02 if fine else None)


def case_of(name: str, k: int, seed: int, data: Path | None, folder: Path, starts: int, only: str = "") -> Case:
    """Return the k-th case of a condition; only: of this part, not of one that is drawn."""
    chance = [seed, zlib.crc32(name.encode()), k]
    rng, condition = np.random.default_rng(chance), CONDITIONS[name]
    names = [n for n in condition.parts or (*OWN, *NIST) if data or n not in NIST]
    if condition.absent == "mirrored":
        names = [n for n in names if not its_own_mirror_image(mesh_of(n, data, False))]
    which = only or names[int(np.random.default_rng(chance[:2]).permutation(len(names))[k % len(names)])]
    model, traced = mesh_of(which, data, False), mesh_of(which, data, True)
    camera = condition.camera(rng)
    middle, reach = model.bounds.mean(axis=0), float(np.linalg.norm(model.size_mm)) / 2
    turn = exp(rng.uniform(0, 2 * np.pi) * np.array([0, 0, 1.0]))  # stands as it was drawn, turned about the upright
    world_from_part = Rigid(turn, -turn @ np.append(middle[:2], model.bounds[0, 2]))
    pose = _view(condition, camera, world_from_part @ middle, reach, rng)
    stage = _stage(condition, traced.transformed(world_from_part), pose, camera, reach, rng)
    truth = pose @ world_from_part
    from_part = truth @ middle
    about = [_turned_over(truth, middle, rng) if condition.turned else truth for _ in range(starts)]
    rough = [_start(camera, near, from_part, rng) for near in about]
    if condition.start:
        rough = [condition.start(truth, rng) for _ in range(starts)]
    up = world_from_part.inv.rotation @ np.array([0, 0, 1.0])
    away = float(from_part[2])
    ranged = ViewRange(axis=up, half_angle_deg=75.0, distance_mm=(0.7 * away, 1.4 * away))
    views = {"": ViewRange(), "range": ranged, "sphere": ViewRange()}[condition.search]
    given = condition.cad or condition.kin
    part = Part.of(condition.model(given(model, rng) if given else model, folder))
    told = condition.told(camera, rng) if condition.told else camera
    truths = [truth]
    if condition.twin:
        there = beside(traced.transformed(world_from_part), rng) @ world_from_part
        second = (traced.transformed(there), stage.things[1][1])
        stage, truths = replace(stage, things=[*stage.things, second]), [truth, pose @ there]
    asked = _asked(condition, model, part, camera, told, truth)
    begin: list[Rigid | None] = [None] if condition.search else list(rough)
    seen = camera, truth, world_from_part, stage
    return Case(f"{name}: {which}", condition, part, *seen, begin, views, chance, told, truths, *asked)


def _asked(
    condition: Condition, model: Mesh, part: Part, camera: Camera, told: Camera, truth: Rigid
) -> tuple[Array, Longs, bool]:
    """Return where the corners of the model that is given are on the part, which are compared, if they can be met."""
    given = part.scene.mesh.vertices
    places = given if condition.cad is None else model.vertices
    if condition.cad is None and condition.told is None:
        return places, np.arange(len(places)), not condition.absent
    corners = visible_corners(part if condition.cad is None else Part.of(model), camera, truth)
    least = least_px(camera.project(truth @ places[corners]), given[corners], told, truth)
    return places, corners, least < ALIKE


def _view(condition: Condition, camera: Camera, middle: Array, reach: float, rng: np.random.Generator) -> Rigid:
    """Return camera_from_world: from above, the part as large in the picture as asked for, wholly in it or cut."""
    share = rng.uniform(*condition.size) * (1.5 if condition.cut else 1.0)
    distance = 2 * reach * camera.fx / (share * min(camera.size)) + reach / 2
    azimuth, elevation = rng.uniform(0, 2 * np.pi), np.radians(rng.uniform(20, 65))
    away = np.array([np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.sin(elevation)])
    pose = Rigid.look_at(middle + distance * away, middle)
    roll = Rigid.exp(np.array([0, 0, 0, 0, 0, rng.uniform(-0.4, 0.4)]))
    aside = 0.5 * (1 - share) * np.array(camera.size) * rng.uniform(-0.6, 0.6, 2)
    if condition.cut:
        aside = np.array([np.sign(rng.uniform(-1, 1)) * 0.5 * camera.width, 0.1 * camera.height])
        aside[0] -= np.sign(aside[0]) * 0.12 * share * camera.height  # so that about a third of it lies outside
    to = camera.unproject((np.array(camera.size) - 1) / 2 + aside)
    turn = np.cross([0, 0, 1.0], to)
    sine = np.linalg.norm(turn)
    return Rigid(exp(turn / max(sine, 1e-12) * np.arctan2(sine, to[2]))) @ roll @ pose


def _start(camera: Camera, truth: Rigid, middle: Array, rng: np.random.Generator) -> Rigid:
    axis, aside = rng.standard_normal(3), rng.standard_normal(2)
    turn = np.radians(rng.uniform(10, 20)) * axis / np.linalg.norm(axis)
    shift = rng.uniform(20, 40) * aside / np.linalg.norm(aside) * middle[2] / camera.fx
    depth = rng.choice([-1, 1]) * rng.uniform(0.05, 0.10) * middle
    about = Rigid(translation=middle)
    return Rigid(translation=np.append(shift, 0.0) + depth) @ about @ Rigid(exp(turn)) @ about.inv @ truth


def _turned_over(truth: Rigid, middle: Array, rng: np.random.Generator) -> Rigid:
    """Return a pose half a turn off, about one of the model's axes through its middle."""
    about = Rigid(translation=middle)
    return truth @ about @ Rigid(exp(np.pi * np.eye(3)[rng.integers(3)])) @ about.inv


def _stage(
    condition: Condition, part: Mesh, pose: Rigid, camera: Camera, reach: float, rng: np.random.Generator
) -> Stage:
    """Return the part on its table, with what stands around it and before it, in light."""
    s = reach
    ground = replace(condition.ground, grain_mm=condition.ground.grain_mm * s / 60)
    own = replace(condition.part, grain_mm=condition.part.grain_mm * s / 60)
    low, high = part.bounds
    table = box((-7 * s, -7 * s, low[2] - 0.3 * s), (7 * s, 7 * s, low[2]), name="table")
    things: list[tuple[Mesh, Surface]] = [(table, ground)]
    if condition.absent != "part":
        things.append((part, own))
    for _ in range(condition.clutter):
        half, angle = s * rng.uniform(0.1, 0.4, 3), rng.uniform(0, 2 * np.pi)
        far = np.hypot(*np.maximum(-low, high)[:2]) + np.hypot(*half[:2]) + s * rng.uniform(0.0, 1.5)
        level = float(rng.uniform(0.1, 0.75))
        body = box((-half).tolist(), half.tolist(), name="box") if rng.random() < 0.6 else _can(half)
        place = Rigid(
            exp(np.array([0, 0, rng.uniform(0, np.pi)])), np.array([far * np.cos(angle), far * np.sin(angle), 0.0])
        )
        body = body.transformed(place)
        body = body.transformed(Rigid(translation=np.array([0, 0, low[2] - body.bounds[0, 2]])))
        things.append((body, Surface((level, level, level), 0.15, own.grain_mm)))
    if condition.hidden:
        things.append((_cover(part, pose, condition.hidden, s, rng), Surface((0.42, 0.42, 0.42), 0.1)))
    if condition.cable:
        things += [(_cable(part, pose, s, rng), Surface(DARK, 0.1)) for _ in range(2)]
    lamps = tuple(
        Lamp((*rng.uniform(-1, 1, 2), rng.uniform(0.6, 1.2)), rng.uniform(0.3, 0.8), rng.uniform(2, 15))
        for _ in range(condition.lamps)
    )
    return Stage(
        things,
        lamps,
        condition.ambient,
        2 * s,
        float(rng.uniform(0.05, 0.4)),
        int(rng.integers(1 << 30)),
        part.vertices,
    )


def _can(half: Array) -> Mesh:
    return prism(circle((0, 0), half[0], 64), -half[2], half[2], name="can")


def _cover(part: Mesh, pose: Rigid, share: float, s: float, rng: np.random.Generator) -> Mesh:
    """Return a box near the part that has about this share of its corners behind it, as the camera sees them."""
    p = pose @ part.vertices
    m, angle = p[:, :2] / p[:, 2:], rng.uniform(0, 2 * np.pi)
    along = np.array([np.cos(angle), np.sin(angle)])
    border, near = np.quantile(m @ along, share), float(p[:, 2].min()) - 0.3 * s
    half = np.array([0.5, 1.2, 0.1]) * s
    across = np.array([-along[1], along[0]])
    centre = near * np.append((border - half[0] / near) * along + (m.mean(axis=0) @ across) * across, 1.0)
    turn = exp(np.array([0, 0, angle]))
    return box((-half).tolist(), half.tolist(), name="cover").transformed(pose.inv @ Rigid(turn, centre))


def _cable(part: Mesh, pose: Rigid, s: float, rng: np.random.Generator) -> Mesh:
    """Return a cable across the view, before the part."""
    middle = pose @ part.bounds.mean(axis=0)
    t, angle = np.linspace(-1, 1, 80), rng.uniform(0, np.pi)
    bow, aside = rng.uniform(-0.3, 0.3), rng.uniform(-0.4, 0.4)
    line = np.stack([2.5 * t, bow * np.cos(2 * t) + aside, np.zeros(80)], axis=1) * s @ exp(np.array([0, 0, angle])).T
    mesh = tube(line, np.array([0, 0, 1.0]), (0.05 * s, 0.02 * s), 24, name="cable", color=DARK)
    return mesh.transformed(pose.inv @ Rigid(translation=middle * (1 - 1.3 * s / middle[2])))


def light_of(case: Case) -> Picture:
    """Return the light (H, W, 3) that falls on the case's pixels, linear, its brightest hundredth at WHITE."""
    camera_from_world = case.truth @ case.world_from_part.inv
    draw = by_pyrender if case.condition.renderer == "pyrender" else radiance
    linear = draw(case.stage, case.camera, camera_from_world)
    return np.asarray(WHITE * linear / max(float(np.quantile(linear, 0.99)), 1e-6), np.float32)


def picture_of(case: Case, folder: Path, light: Callable[[Case], Picture] = light_of) -> Picture:
    """Return the case's picture as its file is read; the file is made if it is not there, of its light."""
    c = case.condition
    path = folder / ("_".join([case.name.split(": ")[1].replace(" ", "-"), *map(str, case.seed)]) + c.suffix)
    if not path.exists():
        taken = c.sensor.apply(light(case), rng=np.random.default_rng(case.seed))
        _write(path, c.spoilt(taken if c.color else to_gray(taken)))
    return read_picture(path, full_scale=4095 if ".12." in path.name else None)


def _write(path: Path, picture: Picture) -> None:
    if path.suffix != ".tif":
        write_picture(path, picture, quality=60)
        return
    import tifffile

    white = 4095 if ".12." in path.name else 65535
    tifffile.imwrite(path, np.round(np.clip(picture, 0, 1) * white).astype(np.uint16))
