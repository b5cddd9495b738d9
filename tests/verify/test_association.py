"""Which of the photo's edges are measured at all."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cadcam.cad.mesh import Mesh, merge
from cadcam.cad.parts.shape import box
from cadcam.geometry.rigid import Rigid
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.verify.deviations.deviation import State
from cadcam.verify.edges.association import _believed
from cadcam.verify.edges.sightlines import pieces, sightlines
from cadcam.verify.edges.step_fit import ROOM_PX, _told_from_twins
from cadcam.verify.edges.survey import Survey, surveyed
from cadcam.verify.inspection import inspect
from cadcam.verify.tolerances.tolerance import whole_parts

from .scene import CAMERA, POSE, part, photo, plate

COLOR = (0.55, 0.55, 0.6)


def survey_of(mesh: Mesh, rng: np.random.Generator) -> Survey:
    whole = Part.of(mesh)
    return surveyed(whole, [photo(mesh, rng)], Rigid(), whole_parts(whole.scene), reach_px=8.0)


@pytest.mark.parametrize("thickness", [3.5, 5.0])
def test_twins_of_one_body_are_measured_true_to_their_errors(rng: np.random.Generator, thickness: float) -> None:
    """A sheet shows two edges 2 to 4 px apart; five sigmas of an edge as a whole."""
    sheet = box((-100, -95, 12), (60, -70, 12 + thickness), name="sheet", color=COLOR)
    seen = survey_of(merge([plate(), sheet]), rng)
    its = seen.lines.part == 5
    twins = its & (seen.lines.room < ROOM_PX + 2) & seen.matched.measured
    assert twins.sum() > 20
    for edge in np.unique(seen.lines.edge[twins]):
        of = twins & (seen.lines.edge == edge)
        sigma = np.hypot(seen.matched.sigma[of].mean() / np.sqrt(of.sum()), seen.matched.common[of].mean())
        assert abs(seen.matched.offset[of].mean()) < 5 * sigma


def test_twins_with_a_border_between_them_for_which_no_line_is_drawn_are_not_measured(rng: np.random.Generator) -> None:
    """What shows between them shifts their steps, and the fit does not know of it."""
    sheet = box((-100, -95, 12), (60, -70, 15.5), name="sheet", color=COLOR)
    mesh = merge([plate(), sheet])
    whole, shot = Part.of(mesh), photo(mesh, rng)
    lines, sights = sightlines(whole, [shot], Rigid())
    seen, body = np.zeros(len(lines)), lines.part.astype(np.int64)
    told, _ = _told_from_twins(lines, sights, body, seen)
    assert (told & (lines.part == 5)).sum() > 20
    between = replace(lines, room=np.minimum(lines.room, 0.5))
    assert not _told_from_twins(between, sights, body, seen)[0][lines.room > 0.5].any()


def test_twins_of_two_bodies_are_not_measured(rng: np.random.Generator) -> None:
    """Either may stand elsewhere, and its edge be taken for the other's."""
    low = box((-100, -95, 12), (60, -70, 14), name="low", color=COLOR)
    high = box((-100, -94, 14), (60, -70, 17), name="high", color=COLOR)
    seen = survey_of(merge([plate(), low, high]), rng)
    twins = seen.usable & (seen.lines.room < ROOM_PX) & (seen.lines.part >= 5)
    assert (twins & seen.matched.support).sum() > 20
    assert not (twins & seen.matched.measured).any()


@pytest.mark.parametrize("turn", [0.0, np.pi / 4, np.arctan(0.5)])
def test_edges_along_rows_of_pixels_are_as_far_off_as_is_said(rng: np.random.Generator, turn: float) -> None:
    """A box seen from straight above, turned to rows, to diagonals, to knight's moves, at many places in a pixel.

    Drawn with 4 x 4 samples a pixel its edges are off, each as a whole, by ten times its noise: by as much, root mean
    square, as is stated (to 40 %: 32 edges, four by four in step), and none by more than 3 sigmas.
    """
    mesh = box((-60, -60, 0), (60, 60, 10), name="box", color=COLOR)
    px = 700.0 / CAMERA.K[0, 0]
    off, said = [], []
    for phase in np.linspace(0, 1, 8, endpoint=False):
        down = np.diag([1.0, -1.0, -1.0])
        at = np.array([phase * px, 0.3 * phase * px, 700.0])
        c, s = np.cos(turn), np.sin(turn)
        pose = Rigid(np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ down, at)
        whole = Part.of(mesh)
        seen = surveyed(whole, [photo(mesh, rng, pose)], Rigid(), whole_parts(whole.scene), reach_px=8.0)
        for edge in np.unique(seen.lines.edge):
            of = (seen.lines.edge == edge) & seen.matched.measured
            if of.sum() >= 20:
                off.append(seen.matched.offset[of].mean())
                said.append(np.hypot(seen.matched.sigma[of].mean() / np.sqrt(of.sum()), seen.matched.common[of].mean()))
    assert len(off) >= 16
    z = np.array(off) / np.array(said)
    assert np.abs(z).max() < 3
    assert 0.6 < np.sqrt((z**2).mean()) < 1.4


@pytest.mark.parametrize(("name", "side"), [("block", "right"), ("rib 1", "left"), ("rib 2", "left")])
def test_a_strip_of_a_body_at_the_picture_s_border_says_nothing_of_it(
    rng: np.random.Generator, name: str, side: str
) -> None:
    """An edge 1 to 5 px from the border has no profile: not to see it was evidence that the body is missing."""
    shot = photo(plate(), rng)
    its = (
        surveyed(part(), [shot], Rigid(), whole_parts(part().scene), reach_px=8.0)
        .shown[0]
        .shows(plate().part_names.index(name))
    )
    columns = np.flatnonzero(its.any(axis=0))
    for left in (2, 3, 4, 5):
        x0, x1 = (0, int(columns[0]) + left) if side == "right" else (int(columns[-1]) + 1 - left, CAMERA.width)
        camera = CAMERA.crop(x0, 0, (x1 - x0, CAMERA.height))
        found = inspect(part(), [Photo.of(shot.gray[:, x0:x1], camera, POSE)], Rigid()).feature(name)
        assert found.presence.expected == 0
        assert abs(found.presence.log_ratio) < 1e-9
        assert found.state is State.OUT_OF_VIEW


def test_a_small_hole_whose_rims_show_in_part_is_believed_to_be_displaced() -> None:
    """Nine places of one rim and two of the other: neither has two pieces of three, both together face two ways."""
    angle = np.radians([33, 60, 79, 95, 112, 136, 175, 263, 278, 278, 261])
    normal = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    shift, bore, ought = np.array([3.0, 1.5]), np.zeros(11, np.int64), np.ones(11, bool)
    groups = pieces(np.repeat([0, 1], [9, 2]), normal), pieces(bore, normal)
    found = (normal @ shift)[:, None]
    assert _believed(found, normal, groups, shift, ought)
    assert not _believed(found, normal, groups[:1], shift, ought)
    straight = np.tile(normal[:1], (11, 1))
    assert not _believed(np.full((11, 1), 3.0), straight, (pieces(bore, straight),) * 2, shift, ought)
