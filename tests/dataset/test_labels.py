"""The labels of a view agree with each other and with geometry worked out apart from the renderer."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cadcam.camera.lens import BrownConrady
from cadcam.dataset.plan import Occluders
from cadcam.dataset.studio import ABSENT, HIDDEN, VISIBLE, Take
from cadcam.geometry.rigid import Rigid
from cadcam.image.sensor.presets import PRESETS
from cadcam.render.raster import RasterRenderer
from cadcam.render.view import Channel

from .sets import CAMERA, HALF, plan, scene, stage_and_director, studio_of

PLANS = {
    "bare": plan(occluders=Occluders()),
    "hidden": plan(occluders=Occluders((2, 4), size=(0.2, 0.5))),
    "cut off": plan(off_centre=0.6, fill=(1.0, 2.0)),
    "lens": plan(camera=replace(CAMERA, lens=BrownConrady(-0.15, 0.02))),
    "jitter": plan(focal_jitter=0.05, centre_jitter_px=4.0),
    "sensor": plan(sensor=PRESETS["global-shutter"], gray=True),
}


@pytest.fixture(scope="module", params=sorted(PLANS))
def takes(request: pytest.FixtureRequest) -> list[Take]:
    made = PLANS[request.param]
    stage, director = stage_and_director(made)
    studio = studio_of(stage)
    return [studio.take(director.shot(index)) for index in range(made.views)]


def test_the_mask_is_where_the_part_is_and_what_is_seen_of_it_lies_within(takes: list[Take]) -> None:
    for take in takes:
        assert not (take.visible & ~take.mask).any()
        assert np.isfinite(take.depth[take.mask]).all()
    assert any(take.visible.any() for take in takes)


def test_the_depth_of_what_is_seen_lies_on_the_part(takes: list[Take]) -> None:
    """Every visible pixel, taken back into the part's frame by camera, depth and pose, is a point of the box: 1e-5."""
    for take in takes:
        rays = take.shot.camera.unproject(take.shot.camera.pixel_grid()[take.visible])
        points = rays / rays[:, 2:] * take.depth[take.visible][:, None].astype(float)
        own = np.abs(take.shot.camera_from_part.inv @ points) / HALF
        np.testing.assert_allclose(own.max(axis=1), 1.0, atol=1e-5)


def test_what_hides_the_part_is_in_front_of_it(takes: list[Take]) -> None:
    for take in takes:
        hidden = take.mask & ~take.visible
        bare = studio_of(stage_and_director(plan())[0]).take(replace(take.shot, occluders=()))
        assert (take.depth[hidden] < bare.depth[hidden]).all()
        assert (take.mask == bare.mask).all()
        assert not hidden.any() or take.shot.occluders


def test_boxes_bound_the_masks(takes: list[Take]) -> None:
    for take in takes:
        x0, y0, x1, y1 = take.whole_box
        inside = np.zeros_like(take.mask)
        inside[max(y0, 0) : y1 + 1, max(x0, 0) : x1 + 1] = True
        assert not (take.mask & ~inside).any()
        assert take.whole_count >= take.mask.sum()
        if take.whole_count == take.mask.sum() and take.mask.any():
            y, x = np.nonzero(take.mask)
            assert (x.min(), y.min(), x.max(), y.max()) == take.whole_box


def test_a_silhouette_counts_what_is_up_to_a_pictures_size_beyond_the_border(takes: list[Take]) -> None:
    """As BOP's own tool does it: the part alone on a canvas of three times the size."""
    width, height = CAMERA.size
    for take in takes:
        wide = take.shot.camera.crop(-width, -height, (3 * width, 3 * height))
        depth = (
            RasterRenderer(scene(), threads=1).render(wide, take.shot.camera_from_part, channels=Channel.DEPTH).depth
        )
        y, x = np.nonzero(np.isfinite(depth))
        assert take.whole_count == len(x)
        assert take.whole_box == (x.min() - width, y.min() - height, x.max() - width, y.max() - height)


def test_key_points_are_where_the_camera_projects_them_and_seen_where_a_face_of_theirs_is(takes: list[Take]) -> None:
    """Of a box without occluders a corner is seen if, and only if, one of its three faces looks at the camera."""
    points = stage_and_director(plan())[0].key_points
    for take in takes:
        p = points @ take.shot.camera_from_part.rotation.T + take.shot.camera_from_part.translation
        m = take.shot.camera.lens.project(p)
        K = take.shot.camera.K
        np.testing.assert_allclose(take.q, m @ K[:2, :2].T + K[:2, 2], atol=1e-9)
        inside = take.shot.camera.sees(take.q)
        assert ((take.seen == ABSENT) == ~inside).all()
        eye = take.shot.camera_from_part.origin
        shown = ((np.sign(points) * (eye - points)) > 0).any(axis=1)
        if not take.shot.occluders:
            assert (take.seen[inside] == np.where(shown, VISIBLE, HIDDEN)[inside]).all()
        else:
            assert not (take.seen[inside & ~shown] == VISIBLE).any()


def test_edges_lie_where_the_camera_projects_them(takes: list[Take]) -> None:
    """Through a lens they may leave the picture by the pixel to which stretches are cut."""
    for take in takes:
        q = take.shot.camera.project(take.shot.camera_from_part @ take.edges.p)
        assert np.abs(q - take.edges.q).max(initial=0.0) < 1e-6
        border = np.array(take.shot.camera.size) - 0.5
        assert np.abs(take.edges.q - np.clip(take.edges.q, -0.5, border)).max(initial=0.0) < 1.0


def test_the_background_is_as_drawn_and_the_part_is_lit() -> None:
    stage, director = stage_and_director(plan(backgrounds=("plain",), occluders=Occluders()))
    take = studio_of(stage).take(director.shot(0))
    level = take.shot.backdrop.level
    assert (take.picture[0, 0] == np.uint8(255 * np.float32(level) + 0.5)).all()
    assert take.picture[take.mask].std() > 0


def test_quick_pictures_are_those_made_layer_by_layer() -> None:
    """A view without occluders over plain grey is drawn in one go: the same to a grey level as over any background."""
    stage, director = stage_and_director(plan(backgrounds=("plain",), occluders=Occluders()))
    studio = studio_of(stage)
    shot = director.shot(1)
    part = studio._part.render(shot.camera, shot.camera_from_part, look=replace(shot.look, background=(0.0, 0.0, 0.0)))
    slow = studio._developed(shot, part, [], None)
    assert np.abs(slow.astype(int) - studio.take(shot).picture).max() <= 1


def test_occluders_touch_nothing_and_stand_before_the_part() -> None:
    stage, director = stage_and_director(plan(40, occluders=Occluders((3, 5), size=(0.2, 0.5))))
    count = 0
    for index in range(40):
        shot = director.shot(index)
        spheres = [(shot.camera_from_part @ director.middle, director.radius)]
        spheres += [
            (at.camera_from_occluder @ stage.props[at.prop].middle, stage.props[at.prop].radius)
            for at in shot.occluders
        ]
        for i, (one, a) in enumerate(spheres):
            assert i == 0 or np.linalg.norm(one) < np.linalg.norm(spheres[0][0])
            assert all(np.linalg.norm(one - other) > a + b for other, b in spheres[:i])
        count += len(shot.occluders)
    assert count > 60


def test_a_part_wholly_out_of_view_is_an_empty_view() -> None:
    made = plan(1, poses=(Rigid(np.eye(3), np.array([900.0, 0.0, 200.0])),), occluders=Occluders())
    stage, director = stage_and_director(made)
    take = studio_of(stage).take(director.shot(0))
    assert not take.mask.any()
    assert (take.seen == ABSENT).all()
    assert len(take.edges) == 0


def test_topics_draw_apart_from_each_other() -> None:
    """Occluders and another background leave poses and lights as they are; another seed or view does not."""
    bare, full = (stage_and_director(plan(occluders=o))[1].shot(3) for o in (Occluders(), Occluders((3, 3))))
    assert bare.camera_from_part.matrix.tobytes() == full.camera_from_part.matrix.tobytes()
    assert bare.look.fill_from == full.look.fill_from
    assert len(full.occluders) > len(bare.occluders) == 0
    for other in (stage_and_director(plan(seed=6))[1].shot(3), stage_and_director(plan())[1].shot(4)):
        assert other.camera_from_part.matrix.tobytes() != bare.camera_from_part.matrix.tobytes()


def test_poses_keep_to_their_range() -> None:
    from cadcam.locate.views.view_range import ViewRange

    around = ViewRange(np.array([1.0, 0, 0]), 30.0, np.array([0.0, 0, 1.0]), 10.0, (300.0, 400.0))
    made = plan(200, around=around, off_centre=0.0, occluders=Occluders())
    director = stage_and_director(made)[1]
    cosines, rolls = [], []
    for index in range(200):
        pose = director.shot(index).camera_from_part
        assert 300 - 1e-9 <= np.linalg.norm(pose.origin) <= 400 + 1e-9
        cosines.append(pose.origin[0] / np.linalg.norm(pose.origin))
        up = pose.rotation @ around.up
        rolls.append(np.degrees(np.arctan2(up[0], -up[1])))
    assert min(cosines) >= np.cos(np.radians(30)) - 1e-9
    assert np.quantile(cosines, 0.5) == pytest.approx(1 - (1 - np.cos(np.radians(30))) / 2, abs=0.02)
    assert max(np.abs(rolls)) <= 10 + 1e-9
    assert np.std(rolls) == pytest.approx(20 / np.sqrt(12), rel=0.15)
