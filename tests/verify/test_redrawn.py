"""Bodies drawn where they stand, deviations still from where the CAD has them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cadcam.cad.parts.shape import box
from cadcam.geometry.rigid import Rigid
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.render import open_renderer
from cadcam.render.view import Channel
from cadcam.verify.adjustment.alarms import AS_IN_PLACE
from cadcam.verify.bodies import findings
from cadcam.verify.bodies.case import Case
from cadcam.verify.bodies.findings import (
    _BY_CHANCE,
    DOUBTFUL,
    _anywhere,
    _likelier,
    _Pixels,
    _standing,
    _Suspect,
    _with_pixels,
    findings_of,
    findings_redrawn,
)
from cadcam.verify.bodies.likelihood import log_likelihoods
from cadcam.verify.bodies.redrawn import displaced as displaced_by
from cadcam.verify.bodies.redrawn import redrawn
from cadcam.verify.deviations.deviation import State
from cadcam.verify.edges.presence import Presence
from cadcam.verify.edges.shown import ShownFaces
from cadcam.verify.edges.survey import Survey, surveyed
from cadcam.verify.inspection import inspect
from cadcam.verify.tolerances.tolerance import whole_parts

from .scene import CAMERA, NOISE, POSE, displaced, part, photo, photographed, plate


def test_a_body_is_drawn_where_it_stands_and_all_else_stays() -> None:
    mesh, by = plate(), np.zeros((5, 3))
    by[mesh.part_names.index("block")] = 1.0, -2.0, 3.0
    drawn = redrawn(part(), by)
    assert drawn is not None
    np.testing.assert_array_equal(drawn.scene.mesh.vertices, displaced("block", np.array([1.0, -2.0, 3.0])).vertices)
    assert drawn.scene.edges is part().scene.edges  # edges keep their numbers


def test_bodies_that_share_vertices_are_not_drawn_apart() -> None:
    mesh = box((0, 0, 0), (10, 10, 10), name="one")
    half = replace(
        mesh,
        part=(np.arange(mesh.n_faces) % 2).astype(np.int32),
        part_names=("one", "two"),
        part_colors=np.repeat(mesh.part_colors, 2, axis=0),
    )
    assert redrawn(Part.of(half), np.ones((2, 3))) is None


def test_offsets_are_from_the_place_in_the_cad_wherever_a_body_is_drawn(rng: np.random.Generator) -> None:
    """The block stands 4 mm off and is drawn there: its offsets are those of 4 mm, its edges near their lines.

    0.1 px: an edge's own error in these pictures is a third of that at most. Its neighbours' offsets are not touched.
    """
    by, moved = np.zeros((5, 3)), np.array([3.0, 2.0, 0.0])
    by[plate().part_names.index("block")] = moved
    drawn = redrawn(part(), by)
    assert drawn is not None
    shot = photo(displaced("block", moved), rng)
    seen = surveyed(drawn, [shot], Rigid(), whole_parts(part().scene), reach_px=8.0, by=by)
    own = seen.members[seen.names.index("block")] & seen.matched.measured
    assert own.sum() > 20
    assert abs(np.median(seen.matched.offset[own] - seen.lines.by_point[own] @ moved)) < 0.1
    assert np.nanmedian(np.abs(seen.matched.coarse[own])) < 0.5
    shift = np.linalg.norm(seen.matched.shift[own], axis=1)
    assert np.all(shift > 2.0)
    others = ~seen.members[seen.names.index("block")] & seen.matched.measured
    assert abs(np.median(seen.matched.offset[others])) < 0.1


def test_a_body_that_was_guessed_to_stand_elsewhere_is_no_less_there_than_in_its_place(
    rng: np.random.Generator,
) -> None:
    """A guess that hardly anything spoke for made a body in place missing: places that were searched cost."""
    asked, shot = whole_parts(part().scene), photo(plate(), rng)
    case = Case(part(), [shot], Rigid(), asked, np.eye(6), 8.0, 0.01)
    look = findings_of(case, part(), surveyed(part(), [shot], Rigid(), asked, reach_px=8.0))
    block, rib = look.survey.names.index("block"), look.survey.names.index("rib 1")

    def told(in_place: float, elsewhere: float, *, drawn: int) -> float:
        """Return L of the block: first in its place, then with that body drawn elsewhere."""
        looks = []
        for L in (in_place, elsewhere):
            presence = [replace(p, log_ratio=L) if i == block else p for i, p in enumerate(look.presence)]
            looks.append(replace(look, presence=presence))
        by = np.zeros((5, 3))
        by[look.survey.whole_part(drawn)] = 4.0
        looks[1] = replace(looks[1], survey=replace(look.survey, by=by))
        return _anywhere(*looks).presence[block].log_ratio

    assert told(-2.5, -8.8, drawn=block) == -2.5
    assert told(-8.8, -2.5, drawn=block) == -2.5
    assert told(+3.0, -8.8, drawn=block) == 0.0  # one of the two is wrong: it is in doubt
    assert told(-2.5, -8.8, drawn=rib) == -8.8  # nothing was guessed


def test_what_edges_and_pixels_explain_counts_once() -> None:
    """A rim as dark as its plate, against the light: each of its two edges fitted the other's, and pixels liked that.

    By neither was that as sure as an alarm has to be, which it was by their sum.
    """
    assert not _likelier(4.7, 5.0, least=8.2)
    assert _likelier(4.7, 8.3, least=8.2)
    assert _likelier(8.3, 0.0, least=8.2)
    assert not _likelier(-9.0, 8.3, least=8.2)
    assert _likelier(-1.0, 1.1, least=0.0)  # where nothing says "in place"


@pytest.mark.parametrize(("by_edges", "told"), [(1.23, -DOUBTFUL), (-0.1, -6.85)])
def test_tones_do_not_miss_a_body_whose_edges_are_seen(
    by_edges: float, told: float, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A bar in the open, 6 of its 9 edges seen (L = 1.2): twice as bright as the light of the corner says, -6.85."""
    asked, shot = whole_parts(part().scene), photo(plate(), rng)
    case = Case(part(), [shot], Rigid(), asked, np.eye(6), 8.0, 0.01)
    survey = surveyed(part(), [shot], Rigid(), asked, reach_px=8.0)
    number = survey.names.index("block")
    own = findings._by_its_edges

    def seen(survey: Survey, i: int) -> Presence:
        return replace(own(survey, i), log_ratio=by_edges) if i == number else own(survey, i)

    monkeypatch.setattr(findings, "_by_its_edges", seen)
    monkeypatch.setattr(findings.Tones, "log_ratio", lambda *_, **__: -6.85)
    monkeypatch.setattr(findings, "_uncovered", lambda *_: 0.0)
    monkeypatch.setattr(findings, "_by_pixels", lambda *_: _Pixels())
    assert findings_of(case, part(), survey).presence[number].log_ratio == told


def by_pixels(name: str, taken: Photo, *, drawn_at: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> _Pixels:
    """Return what all pixels of a photo say of a body of the plate that is drawn somewhere."""
    case = Case(part(), [taken], Rigid(), whole_parts(part().scene), np.eye(6), 8.0, 0.01)
    survey = surveyed(part(), [taken], Rigid(), case.asked, reach_px=8.0)
    body = survey.whole_part(survey.names.index(name))
    assert body is not None
    by = np.zeros((len(part().scene.mesh.part_names), 3))
    by[body] = drawn_at
    drawn = redrawn(part(), by)
    assert drawn is not None
    survey = surveyed(drawn, [taken], Rigid(), case.asked, reach_px=8.0, by=by)
    return findings._by_pixels(case, drawn, survey, body)


@pytest.mark.parametrize("name", ["block", "bracket"])
def test_all_pixels_tell_a_body_that_is_there_from_one_that_is_not(name: str, rng: np.random.Generator) -> None:
    """Where it is drawn elsewhere they say nothing: it was searched for until they liked it."""
    there, gone = photo(plate(), rng), photo(displaced(name, None), rng)
    assert by_pixels(name, there).there > 10 * _BY_CHANCE
    assert by_pixels(name, gone).there < -_BY_CHANCE
    assert by_pixels(name, gone).gone > _BY_CHANCE > 0 > by_pixels(name, there).gone
    assert by_pixels(name, there, drawn_at=(3.0, 0.0, 0.0)) == _Pixels()


def test_pixels_speak_for_what_explains_them_better_than_both_others(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Not for the absence of a body that something of one tone explains better than its absence does."""
    monkeypatch.setattr(findings, "log_likelihoods", lambda *_: (np.array([-50.0]), -20.0, -5.0))
    assert by_pixels("block", photo(plate(), rng)) == _Pixels(there=-45.0, gone=-15.0)


def test_a_patch_of_paint_of_a_bodys_shape_is_not_the_body(rng: np.random.Generator) -> None:
    """Of two surfaces that a rib has and two that it hides neither are so dark: something is before them."""
    its = open_renderer(part().scene).render(CAMERA, POSE, channels=Channel.PART).part == 2
    painted = np.where(its, 0.1 + rng.normal(0, NOISE, its.shape), photographed(plate(), rng))
    told = by_pixels("rib 2", Photo.of(np.clip(painted, 0, 1).astype(np.float32), CAMERA, POSE))
    assert max(told.there, told.gone) < -_BY_CHANCE


def test_pixels_stand_in_for_tones_where_they_are_for_a_body() -> None:
    """By at most 3.5. Against it they are not heard; and where what it would hide does not show, it is in doubt."""
    assert _with_pixels(-3.4, 0.5, _Pixels(93.0, -93.0)) == 4.0
    assert _with_pixels(-3.4, 0.5, _Pixels(_BY_CHANCE + 1.0, -15.0)) == 1.5
    assert _with_pixels(1.9, -4.0, _Pixels(93.0, -93.0)) == 1.9  # edges that are missed all the same
    assert (
        _with_pixels(-6.9, -1.3, _Pixels(-300.0, 290.0)) == _with_pixels(-6.9, -1.3, _Pixels(_BY_CHANCE, 0.0)) == -6.9
    )
    assert _with_pixels(-6.9, -1.3, _Pixels(-300.0, -20.0)) == -DOUBTFUL


def test_a_doubtful_body_is_there_if_its_pixels_say_so(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Tones predicted by a light that is off say -6.85 of a block half of whose edges are seen."""
    shot = photo(plate(), rng)
    case = Case(part(), [shot], Rigid(), whole_parts(part().scene), np.eye(6), 8.0, 0.01)
    survey = surveyed(part(), [shot], Rigid(), case.asked, reach_px=8.0)
    number, own = survey.names.index("block"), findings._by_its_edges

    def half_seen(survey: Survey, i: int) -> Presence:
        return replace(own(survey, i), log_ratio=-0.5) if i == number else own(survey, i)

    monkeypatch.setattr(findings, "_by_its_edges", half_seen)
    monkeypatch.setattr(findings.Tones, "log_ratio", lambda *_, **__: -6.85)
    assert findings_of(case, part(), survey).presence[number].log_ratio == 3.0


@pytest.mark.parametrize("measured", [True, False])
def test_tones_do_not_move_a_body_whose_edges_say_that_it_is_in_place(
    measured: bool, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A patch of sun beside a bar, which no light of the model throws, spoke for another place by 98, its edges by -10.

    Not measured, the body may be there: then tones are what is known of it.
    """
    asked, shot = whole_parts(part().scene), photo(plate(), rng)
    case = Case(part(), [shot], Rigid(), asked, np.eye(6), 8.0, 0.01)
    look = findings_of(case, part(), surveyed(part(), [shot], Rigid(), asked, reach_px=8.0))
    number = look.survey.names.index("block")
    body, moved = look.survey.whole_part(number), displaced_by(look.measured, number)
    assert body is not None
    assert moved is not None
    assert moved.p_value > AS_IN_PLACE
    suspect = _Suspect(number, body, moved if measured else None)
    told = [(np.array([4.0, 2.0, 0.0]), 98.0), (None, 0.0)]
    monkeypatch.setattr("cadcam.verify.bodies.findings._suspects", lambda case, look: [suspect])
    monkeypatch.setattr("cadcam.verify.bodies.findings._likeliest", lambda *_: told.pop(0))
    assert bool(findings_redrawn(case, look).survey.by[body].any()) is not measured


@pytest.mark.parametrize("by", [(-2.62, -3.23, 0.0), (-3.03, -0.47, -3.8), (-1.22, -2.05, -3.0)])
def test_a_line_that_a_displaced_body_uncovers_is_not_taken_for_its_own(
    by: tuple[float, float, float], rng: np.random.Generator
) -> None:
    """The rim of the plate lies 1.1 px inside the bracket's rear edge, and shows as the bracket slides to the front.

    It was taken for that edge, as there was none where the bracket was measured: it was drawn sunk, its feet hidden.
    The last is drawn first with its edge on that rim. They were off by 11 to 43 sigmas. A component is off by over 4
    once in 16 000 cases.
    """
    seen = inspect(part(), [photo(displaced("bracket", np.array(by)), rng)], Rigid()).feature("bracket")
    assert seen.state is State.DISPLACED
    assert seen.displacement is not None
    off = seen.displacement.value - seen.seen.T @ np.array(by)
    assert np.abs(np.linalg.solve(np.linalg.cholesky(seen.displacement.covariance), off)).max() < 4.0


def test_a_body_is_drawn_standing_on_its_ground(rng: np.random.Generator) -> None:
    """One photo does not show how far a body moves along the line of sight: it neither sinks nor rises."""
    asked, shot = whole_parts(part().scene), photo(plate(), rng)
    survey = surveyed(part(), [shot], Rigid(), asked, reach_px=8.0)
    block = survey.names.index("block")
    to = _standing(survey, block, np.array([1.0, 2.0, -1.0]))
    assert abs(to[2]) < 1e-9
    sight = survey.lines.p[survey.members[block]].mean(axis=0) - POSE.origin
    assert np.linalg.norm(np.cross(to - [1.0, 2.0, -1.0], sight)) < 1e-9 * np.linalg.norm(sight)


def test_lines_of_moved_bodies_are_those_of_a_model_made_so() -> None:
    """What the drawer takes over from the CAD in place is what it would find anew, moved through one another too."""
    for by in ((4.0, -2.0, 0.0), (-60.0, 0.0, 5.0)):
        to = np.zeros((5, 3))
        to[plate().part_names.index("block")] = by
        drawn = redrawn(part(), to)
        assert drawn is not None
        anew = Part(drawn.scene).lines.draw(CAMERA, POSE).visible
        taken = drawn.lines.draw(CAMERA, POSE).visible
        for name in ("q", "p", "segment", "start", "kind", "part", "chain"):
            np.testing.assert_array_equal(getattr(taken, name), getattr(anew, name))


def test_places_of_a_body_are_compared_by_what_is_near_them(rng: np.random.Generator) -> None:
    """All pixels of the places are those of the whole part's picture; what is far away is not drawn."""
    asked, shot = whole_parts(part().scene), photo(displaced("rib 2", np.array([0.0, 2.0, 0.0])), rng)
    case = Case(part(), [shot], Rigid(), asked, np.eye(6), 8.0, 0.01)
    rib = plate().part_names.index("rib 2")
    places = np.zeros((3, 5, 3))
    places[1:, rib] = (0.0, 2.0, 0.0), (0.0, -3.0, 0.0)
    near = case.beside(part(), rib, list(places))
    whole = [drawn for drawn in (redrawn(part(), by) for by in places) if drawn is not None]
    shown = [ShownFaces.of(part(), shot, Rigid())]
    told, expected = (log_likelihoods([shot], Rigid(), guesses, rib, shown) for guesses in (near, whole))
    np.testing.assert_allclose(told[0], expected[0], rtol=1e-12)
    np.testing.assert_allclose(told[1:], expected[1:], rtol=1e-12)
    assert int(np.argmax(told[0])) == 1
    assert near[0].scene.mesh.n_faces < plate().n_faces
