"""What brightness says: is a body there, on which side of an edge is it brighter, where does a body stand."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import binary_dilation

from cadcam.cad.mesh import merge
from cadcam.cad.parts.shape import box, circle, extruded, filled
from cadcam.geometry.rigid import Rigid
from cadcam.image.profile import noise_of
from cadcam.locate.lines.sight import Sight
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.locate.quality.light import fitted_light
from cadcam.render import open_renderer
from cadcam.render.view import Channel
from cadcam.verify.bodies.likelihood import log_likelihoods
from cadcam.verify.bodies.openness import Sky
from cadcam.verify.bodies.redrawn import redrawn
from cadcam.verify.bodies.tones import Tones, _SurfacePixels
from cadcam.verify.deviations.deviation import State
from cadcam.verify.edges.association import nearby_edges, strays
from cadcam.verify.edges.shown import ShownFaces
from cadcam.verify.edges.sightlines import STEP_PX, sightlines
from cadcam.verify.edges.surroundings import edge_surroundings
from cadcam.verify.edges.survey import surveyed
from cadcam.verify.inspection import inspect
from cadcam.verify.tolerances.tolerance import whole_parts

from .scene import CAMERA, NOISE, POSE, displaced, part, photo, photographed, plate

SMALL = [name for name in plate().part_names if name != "plate"]


def shown_in(shot: Photo) -> ShownFaces:
    return ShownFaces.of(part(), shot, Rigid())


def tones_of(shot: Photo) -> Tones:
    return Tones(part(), [shot], Rigid(), [shown_in(shot)])


@pytest.mark.parametrize("name", SMALL)
def test_a_body_has_its_own_tones_and_where_it_is_missing_those_behind_it(rng: np.random.Generator, name: str) -> None:
    """Surely, both ways: with 5 bodies in view 6.5 is enough for either."""
    body = plate().part_names.index(name)
    assert tones_of(photo(plate(), rng)).log_ratio(body) > 6.5
    assert tones_of(photo(displaced(name, None), rng)).log_ratio(body) < -6.5


def test_a_round_body_has_its_tones_though_each_of_its_strips_is_narrow(rng: np.random.Generator) -> None:
    """None of its 96 strips is wide enough to have one of its own: together they say that it is there, or gone."""
    pin = extruded([filled(circle((-20, 0), 16, 96))], 12, 40, name="pin", color=(0.55, 0.55, 0.6))
    whole = Part.of(merge([plate(), pin]))
    for mesh, there in ((whole.scene.mesh, 1.0), (plate(), -1.0)):
        shot = photo(mesh, rng)
        tones = Tones(whole, [shot], Rigid(), [ShownFaces.of(whole, shot, Rigid())])
        assert there * tones.log_ratio(5) > 6.5
        state = inspect(whole, [shot], Rigid()).feature("pin").state
        assert state is (State.IN_PLACE if there > 0 else State.MISSING)


def test_the_pieces_of_one_surface_are_off_their_tone_together() -> None:
    """What lies before and behind cuts a face into pieces: light that is not as fitted changes all of them alike."""
    normal, color = np.tile([0.0, 0.0, 1.0], (90, 1)), np.zeros(90, np.int32)
    surface = np.zeros(90, np.int64)
    beside = Sky.of(part(), photo(plate(), np.random.default_rng(0)), Rigid(), (slice(0, 5), slice(0, 5)))
    pixels = _SurfacePixels(normal, color, surface, np.zeros((90, 2)), beside)  # where there is nothing of the part
    light = fitted_light(
        np.full((40, 40), 0.5, np.float32), np.tile([0.0, 0.0, 1.0], (40, 40, 1)), np.zeros((40, 40), np.int32)
    )
    pieces = [np.arange(k, k + 30) for k in (0, 30, 60)]
    alike, apart = (pixels.log_density(light, 0.5 + 0.1 * np.array(way), pieces) for way in ([1, 1, 1], [1, -1, 1]))
    assert alike > apart + 6.5


def test_a_shadow_on_a_body_does_not_make_it_missing(rng: np.random.Generator) -> None:
    """All of the block is darker by a third: neither as it should be nor as what is behind it."""
    gray, body = photographed(plate(), rng), plate().part_names.index("block")
    its = open_renderer(part().scene).render(CAMERA, POSE, channels=Channel.PART).part == body
    dark = Photo.of(np.where(its, 0.66 * gray, gray).astype(np.float32), CAMERA, POSE)
    assert tones_of(dark).log_ratio(body) > -6.5
    assert State.MISSING not in {f.state for f in inspect(part(), [dark], Rigid()).features}


def test_a_body_that_is_gone_from_a_shadow_is_missing(rng: np.random.Generator) -> None:
    """All around its place is darker by a third: not as bright as the light makes it, but as beside it."""
    gray, body = photographed(displaced("block", None), rng), plate().part_names.index("block")
    its = open_renderer(part().scene).render(CAMERA, POSE, channels=Channel.PART).part == body
    shadow = binary_dilation(its, iterations=30)
    dark = Photo.of(np.where(shadow, 0.66 * gray, gray).astype(np.float32), CAMERA, POSE)
    assert tones_of(dark).log_ratio(body) < -2.0
    assert inspect(part(), [dark], Rigid()).feature("block").state is State.MISSING


def test_the_light_knows_to_which_side_an_edge_is_brighter(rng: np.random.Generator) -> None:
    """Where it says so, the photo's own sides agree: noise alone would turn none of steps this large."""
    shot = photo(plate(), rng)
    lines, _ = sightlines(part(), [shot], Rigid())
    way = edge_surroundings([shot], [shown_in(shot)], lines).way
    told = (way != 0) & (lines.room > 5.0)
    assert told.sum() > 30
    sides = [np.rint(lines.q[told] + t * lines.normal[told]).astype(int) for t in (-3.0, 3.0)]
    before, after = (shot.gray[q[:, 1], q[:, 0]] for q in sides)
    assert np.mean(np.sign(after - before) == way[told]) > 0.95


def test_edges_that_step_the_other_way_are_not_taken(rng: np.random.Generator) -> None:
    shot = photo(plate(), rng)
    lines, _ = sightlines(part(), [shot], Rigid())
    sights = [Sight.of(part(), shot, Rigid(), step_px=STEP_PX, reach_px=14.0, noise=noise_of(shot.gray))]
    way = edge_surroundings([shot], [shown_in(shot)], lines).way
    right = nearby_edges(lines, sights, reach_px=1.5, way=way)
    wrong = nearby_edges(lines, sights, reach_px=1.5, way=-way)
    told = (way != 0) & (lines.room > 5.0)
    assert np.isfinite(right[told]).any(axis=1).mean() > 0.9
    assert np.isfinite(wrong[told]).any(axis=1).mean() < 0.1


def test_an_edge_is_seen_where_it_shows_at_all_places_that_ought_to(rng: np.random.Generator) -> None:
    """A third of an edge stands before something of another tone: it is found there, and only there."""
    along, edge = 4.0 * np.arange(30), np.zeros(30, np.int64)
    offset = np.where(np.arange(30) < 10, 0.3 + rng.normal(0, 0.1, 30), np.nan)
    sigma, every = np.full(30, 0.1), np.ones(30, bool)
    assert not strays(offset, sigma, edge, along, every, np.arange(30) < 10)[:10].any()
    assert strays(offset, sigma, edge, along, every, every)[:10].all()


@pytest.mark.parametrize("name", SMALL)
def test_the_photo_looks_most_like_the_body_where_it_stands(rng: np.random.Generator, name: str) -> None:
    """Guesses from the edges nearby are some pixels apart; the nearest of them to the truth is the likeliest."""
    body, truth = plate().part_names.index(name), np.array([-3.0, 4.0, 0.0])
    shot = photo(displaced(name, truth), rng)
    seen = surveyed(part(), [shot], Rigid(), whole_parts(part().scene), reach_px=8.0)
    places = [np.zeros(3), *seen.guesses(seen.names.index(name), reach_px=8.0)]
    off = []
    for place in places:
        rows = seen.members[seen.names.index(name)]
        off.append(float(np.abs(seen.lines.by_point[rows] @ (place - truth)).max()))
    assert min(off) < 1.5
    by = [np.zeros((5, 3)) for _ in places]
    for i, place in enumerate(places):
        by[i][body] = place
    guesses = [g for g in (redrawn(part(), b) for b in by) if g is not None]
    found, without, _ = log_likelihoods([shot], Rigid(), guesses, body, [shown_in(shot)])
    assert off[int(np.argmax(found))] < 1.5
    assert found.max() > without


def test_where_a_body_is_missing_the_photo_looks_most_like_the_part_without_it(rng: np.random.Generator) -> None:
    body, shot = plate().part_names.index("block"), photo(displaced("block", None), rng)
    by = np.zeros((5, 3))
    by[body] = 3.0, 3.0, 0.0
    moved = redrawn(part(), by)
    assert moved is not None
    found, without, hidden = log_likelihoods([shot], Rigid(), [part(), moved], body, [shown_in(shot)])
    assert without > max(found.max(), hidden)


@pytest.mark.parametrize("tone", [0.1, 0.7])
@pytest.mark.parametrize("beyond", [1, 8])
def test_a_patch_of_paint_before_a_body_does_not_speak_for_it(
    tone: float, beyond: int, rng: np.random.Generator
) -> None:
    """Not even if it has its shape: it has not its tones. Nor does it look like what the body would hide."""
    gray = photographed(plate(), rng)
    seen = open_renderer(part().scene).render(CAMERA, POSE, channels=Channel.PART).part
    for body in range(1, len(plate().part_names)):
        cover = binary_dilation(seen == body, iterations=beyond)
        painted = np.where(cover, tone + rng.normal(0, NOISE, gray.shape), gray).astype(np.float32)
        shot = Photo.of(np.clip(painted, 0, 1), CAMERA, POSE)
        found, without, hidden = log_likelihoods([shot], Rigid(), [part()], body, [shown_in(shot)])
        assert found[0] < max(without, hidden)
        assert beyond > 1 or hidden > without


@pytest.mark.parametrize("more", [-0.08, 0.08])
@pytest.mark.parametrize("name", ["rib 1", "rib 2"])
def test_a_body_of_another_tone_than_the_light_says_stays_where_its_borders_are(
    rng: np.random.Generator, name: str, more: float
) -> None:
    """Elsewhere its tone would be less wrong, but where its borders are not."""
    body = plate().part_names.index(name)
    its = open_renderer(part().scene).render(CAMERA, POSE, channels=Channel.PART).part == body
    shot = Photo.of((photographed(plate(), rng) + more * its).astype(np.float32), CAMERA, POSE)
    by = np.zeros((9, 5, 3))
    by[1:, body, :2] = 9.0 * np.stack([np.cos(np.arange(8) * np.pi / 4), np.sin(np.arange(8) * np.pi / 4)], axis=1)
    guesses = [g for g in (redrawn(part(), b) for b in by) if g is not None]
    found, without, _ = log_likelihoods([shot], Rigid(), guesses, body, [shown_in(shot)])
    assert np.argmax(found) == 0
    assert found[0] > without


@pytest.mark.parametrize("more", [-0.1, 0.1])
def test_a_narrow_surface_of_another_tone_leaves_its_body_where_it_stands(
    rng: np.random.Generator, more: float
) -> None:
    """The top of a fin, 60 px in view, is darker than the light says, or brighter; its borders are where they are.

    Sharing a tone with all that is small, it made a place 5 mm beside likelier, and the more so the darker it was.
    """
    fin = box((-100, -95, 12), (-70, -90, 42), name="fin", color=(0.55, 0.55, 0.6))
    whole = Part.of(merge([plate(), fin]))
    plain = photo(whole.scene.mesh, rng)
    shown = ShownFaces.of(whole, plain, Rigid())
    top = shown.shows(5) & (shown.normal[:, 2] > 0.9)[shown.face]
    assert 40 < top.sum() < 80
    shot = Photo.of(np.clip(plain.gray + more * top, 0, 1).astype(np.float32), CAMERA, POSE)
    by, turn = np.zeros((17, 6, 3)), np.arange(8) * np.pi / 4
    ring = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    by[1:9, 5, :2], by[9:, 5, :2] = 5.0 * ring, 9.0 * ring
    guesses = [g for g in (redrawn(whole, b) for b in by) if g is not None]
    found, without, _ = log_likelihoods([shot], Rigid(), guesses, 5, [shown])
    assert found[0] > max(found[1:].max(), without) + 6.5


def test_guesses_of_a_small_body_leave_its_places_as_they_were(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where its feet are used as well: those in all photos but one were lost from the survey."""
    monkeypatch.setattr("cadcam.verify.edges.survey._LEAST_GUESSED", 1000)
    beside = Rigid.look_at((500.0, -500.0, 700.0), (0.0, 0.0, 0.0))
    shots = [photo(plate(), rng), photo(plate(), rng, beside, name="beside")]
    seen = surveyed(part(), shots, Rigid(), whole_parts(part().scene), reach_px=8.0)
    number = seen.names.index("rib 1")
    before = seen.members[number].copy()
    assert len(np.unique(seen.lines.photo[before])) == 2
    assert seen.guesses(number, reach_px=8.0)
    np.testing.assert_array_equal(seen.members[number], before)
