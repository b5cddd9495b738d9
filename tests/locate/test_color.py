"""What colour tells of a pose: a coloured wedge half hidden on a chequered cloth, and what must not count."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from cadcam.arrays import Array, Picture
from cadcam.cad.parts.shape import box, prism
from cadcam.geometry.rigid import Rigid
from cadcam.image.chroma import chroma_of
from cadcam.image.picture import to_gray
from cadcam.locate.lines.sight import Sight
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.locate.quality import support
from cadcam.locate.quality.chequers import along_chequers
from cadcam.locate.quality.color import by_color
from cadcam.locate.quality.support import ShownLines
from cadcam.locate.refine.options import EDGES
from cadcam.locate.refine.refinement import refine_pose
from cadcam.native.profiles import values_at
from cadcam.render import open_renderer
from cadcam.render.view import Channel, Scene

from .photos import CAMERA, LOOK, view

SIDE, HIGH = 66.0, 12.0  # mm
WEDGE = prism([(0.0, 0.0), (SIDE, 0.0), (SIDE / 2, SIDE * np.sqrt(0.75))], 0.0, HIGH, name="wedge")
PART = Part.of(WEDGE)
POSE = view(PART, (-0.3, -0.8, 0.6), away=11.0)
GREEN, GRAY, ORANGE = (0.35, 0.65, 0.15), (0.5, 0.5, 0.5), (0.85, 0.4, 0.05)
OCCLUDED = 0.62  # of the wedge's breadth: from there on something stands before it


def cloth(square: float = 34.0, low: float = 0.15, high: float = 0.75) -> Picture:
    """Return a chequered ground (480, 640, 3), turned so that no line of it runs as the wedge's do."""
    x, y = np.meshgrid(np.arange(640.0), np.arange(480.0))
    u, v = x + 0.35 * y, y - 0.35 * x
    dark = (np.floor(u / square) + np.floor(v / square)) % 2 > 0
    return np.repeat(np.where(dark, low, high)[..., None], 3, axis=2).astype(np.float32)


def picture(color: tuple[float, float, float], ground: Picture, *, part: Part = PART, pose: Rigid = POSE) -> Picture:
    """Return the part in a colour on the ground, clean."""
    scene = Scene.of(part.scene.mesh, colors=[color] * len(part.scene.mesh.part_names))
    shaded = open_renderer(scene, threads=1).render(CAMERA, pose, look=LOOK, channels=Channel.IMAGE)
    cover = shaded.coverage[..., None]
    background = np.asarray(LOOK.background, np.float32)
    return np.asarray(shaded.image - (1 - cover) * background + (1 - cover) * ground, np.float32)


def covered(clean: Picture, color: tuple[float, float, float] = ORANGE) -> tuple[Picture, float]:
    """Return the picture with a board of another colour before the wedge's right part, and where that begins (px)."""
    x = CAMERA.project(POSE @ WEDGE.vertices)[:, 0]
    first = float(x.min() + OCCLUDED * np.ptp(x))
    out = clean.copy()
    out[:, round(first) :] = color
    return out, first


def taken(clean: Picture, rng: np.random.Generator) -> Photo:
    """Return the photo: blurred by 0.6 px, with noise, in steps of 1/255."""
    blurred = gaussian_filter(clean, 0.6, axes=(0, 1))
    noisy = np.clip(blurred + 0.01 * rng.normal(size=clean.shape), 0, 1)
    return Photo.of(np.asarray(np.round(255 * noisy) / 255, np.float32), CAMERA)


def sight(photo: Photo, pose: Rigid = POSE, part: Part = PART) -> Sight:
    """Return the part's samples there."""
    return Sight.of(part, photo, pose, step_px=EDGES.step_px, reach_px=2 * EDGES.reach_px)


def share(photo: Photo, pose: Rigid = POSE, part: Part = PART) -> float:
    """Return the share of the samples that colour speaks for."""
    return by_color(part, sight(photo, pose, part), pose).share


def beside(px: float, degrees: float, rng: np.random.Generator) -> Rigid:
    """Return the pose with the part shifted across the view and turned about its middle, in random directions."""
    middle = POSE @ PART.aspects.centre
    way, axis = rng.normal(size=2), rng.normal(size=3)
    turn = Rigid.exp([0, 0, 0, *np.radians(degrees) * axis / np.linalg.norm(axis)])
    there = Rigid(translation=[*(middle[:2] + px * middle[2] / CAMERA.fx * way / np.linalg.norm(way)), middle[2]])
    return there @ turn @ Rigid(translation=-middle) @ POSE


def test_chroma_is_nil_where_a_picture_is_grey_and_keeps_its_hue_in_shade(rng: np.random.Generator) -> None:
    gray = rng.random((6, 8)).astype(np.float32)
    assert chroma_of(gray) is None
    assert chroma_of(np.repeat(gray[..., None], 3, axis=2)) is None
    lit, shaded = (chroma_of(np.full((1, 1, 3), k * np.array(GREEN), np.float32)) for k in (1.0, 0.4))
    assert lit is not None
    assert shaded is not None
    assert 0.4 * lit == pytest.approx(shaded, abs=1e-6)


def test_values_between_pixels_are_those_of_a_plane_and_none_outside() -> None:
    y, x = np.mgrid[:5, :7].astype(np.float32)
    plane = np.stack([2 * x - y, x + 3 * y], axis=2)
    q = np.array([[0, 0], [6, 4], [2.25, 3.5], [6.0, 1.75]])
    assert values_at(plane, q) == pytest.approx(np.stack([2 * q[:, 0] - q[:, 1], q[:, 0] + 3 * q[:, 1]], axis=1))
    assert np.isnan(values_at(plane, np.array([[-0.1, 2.0], [3.0, 4.1]]))).all()


def test_a_grey_photo_in_three_channels_is_located_as_in_one(rng: np.random.Generator) -> None:
    gray, start = taken(picture(GRAY, cloth()), rng).gray, beside(2, 1, rng)
    one, three = (
        refine_pose(PART, [Photo.of(p, CAMERA)], start) for p in (gray, np.repeat(gray[..., None], 3, axis=2))
    )
    assert three.quality == pytest.approx(one.quality, abs=1e-6)  # luma of equal channels is rounded
    assert three.pose.world_from_part.matrix == pytest.approx(one.pose.world_from_part.matrix, abs=1e-5)
    assert "colour" not in one.reason + three.reason


def test_colour_speaks_for_the_right_pose_and_for_none_beside_it(rng: np.random.Generator) -> None:
    photo = taken(picture(GREEN, cloth()), rng)
    assert share(photo) > 0.85
    assert max(share(photo, beside(14, 0, rng)) for _ in range(12)) < 0.25
    assert max(share(photo, beside(40, 30, rng)) for _ in range(12)) < 0.1


def test_colour_says_nothing_of_a_part_as_grey_as_what_is_around(rng: np.random.Generator) -> None:
    ground = cloth()
    ground[:, :100] = ORANGE  # somewhere else
    assert share(taken(picture(GRAY, ground), rng)) < 0.05


def test_what_stands_before_the_part_is_told_by_its_colour(rng: np.random.Generator) -> None:
    clean, first = covered(picture(GREEN, cloth()))
    seen = sight(taken(clean, rng))
    told = by_color(PART, seen, POSE)
    x = seen.project(POSE).q[:, 0]
    assert told.hidden[x > first + 8].mean() > 0.9  # but for corners, where there is no room beside a line
    assert not told.hidden[x < first - 12].any()  # two samples beside it may be mixed
    assert told.share > 0.85


def test_a_wedge_half_hidden_is_found_by_its_colour_and_not_without(rng: np.random.Generator) -> None:
    clean, _ = covered(picture(GREEN, cloth()))
    found = []
    for _ in range(5):
        photo, start = taken(clean, rng), beside(2, 1, rng)
        colored, gray = (refine_pose(PART, [p], start) for p in (photo, replace(photo, chroma=None)))
        off = CAMERA.project(colored.pose.world_from_part @ WEDGE.vertices) - CAMERA.project(POSE @ WEDGE.vertices)
        assert not colored.found or np.linalg.norm(off, axis=1).max() < 3, colored.reason
        found.append((colored.found, gray.found))
    assert sum(c for c, _ in found) >= 4
    assert sum(g for _, g in found) <= 1


def test_a_printed_part_is_no_worse_off_in_colour(rng: np.random.Generator) -> None:
    """Print of another colour on a face: colour may help less, but never counts against a pose."""
    part = Part.of(box([0, 0, 0], [100, 70, 40], name="box"))
    pose = view(part, (-0.5, -0.8, 0.7), away=7.0)
    clean = picture(GREEN, cloth(), part=part, pose=pose)
    x, y = CAMERA.project(pose @ np.array([50.0, 35.0, 40.0]))
    clean[round(y) - 25 : round(y) + 25, round(x) - 60 : round(x) + 10] = ORANGE
    photo = taken(clean, rng)
    colored, gray = (refine_pose(part, [p], pose) for p in (photo, replace(photo, chroma=None)))
    assert colored.quality >= gray.quality
    assert colored.found


def runs(q: Array) -> tuple[Array, Array, Array]:
    """Return samples on a straight line: places, normals, one run."""
    along = (q[-1] - q[0]) / np.linalg.norm(q[-1] - q[0])
    return q, np.tile([-along[1], along[0]], (len(q), 1)), np.zeros(len(q), np.int32)


def test_a_line_through_corners_of_chequers_is_told_from_a_border_before_them(rng: np.random.Generator) -> None:
    gray = gaussian_filter(to_gray(cloth(square=24.0)), 0.6)
    t = np.arange(0.0, 100.0, 4.0)
    across, step = np.array([1.0, 0.35]) / (1 + 0.35**2), np.array([-0.35, 1.0]) / (1 + 0.35**2)
    on_corners = 240 * across + 48 * step + 5 * 24 * across + t[:, None] * step / np.linalg.norm(step)
    assert along_chequers(gray, *runs(on_corners)).all()
    border = gray.copy()
    q = np.array([300.0, 100.0]) + t[:, None] * np.array([0.0, 1.0])
    border[:, :301] = 0.45  # a plain part
    assert not along_chequers(border, *runs(q)).any()


def test_one_place_where_sides_swap_is_no_row_of_corners() -> None:
    """A long border may cross one such place in clutter: it takes a second before the line is a pattern's."""
    gray = np.full((200, 500), 0.3)
    gray[:100, 250:] = 0.7
    gray[100:, :250] = 0.7
    q = np.column_stack([np.arange(20.0, 480.0, 4.0), np.full(115, 99.5)])
    assert not along_chequers(gray, *runs(q)).any()
    assert along_chequers(np.tile(gray[50:150, 200:300], (1, 5)), *runs(q - [0.0, 50.0])).all()


def test_a_few_samples_tell_no_pattern() -> None:
    gray = np.full((20, 60), 0.5)
    for n in range(2, 8):
        assert not along_chequers(gray, *runs(np.column_stack([np.arange(n) * 4.0 + 10.0, np.full(n, 9.5)]))).any()


def test_where_all_that_is_shown_lies_on_chequers_nothing_speaks_for_the_part(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Some samples have no step: of those that do, none is left, though more were asked than had one."""
    clean, _ = covered(picture(ORANGE, np.full((480, 640, 3), 0.5, np.float32)))
    half = sight(taken(clean, rng))
    before = ShownLines.of(half, POSE, 1.0)
    assert 0.2 < before.here.mean() < 0.9
    monkeypatch.setattr(support, "along_chequers", lambda *_: np.ones(len(before.which), bool))
    on_chequers = ShownLines.of(half, POSE, 1.0)
    assert not on_chequers.here.any()
    assert on_chequers.share[0] == 0
