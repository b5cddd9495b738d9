"""The labels of a view agree with each other and with geometry worked out apart from the renderer."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cadcam.cad.parts.shape import box
from cadcam.camera.camera import Camera
from cadcam.camera.lens import BrownConrady
from cadcam.dataset.plan import Occluders
from cadcam.dataset.view_renderer import ABSENT, HIDDEN, VISIBLE, LabelledView
from cadcam.geometry.rigid import Rigid
from cadcam.image.sensor.presets import PRESETS
from cadcam.locate.views.view_range import ViewRange
from cadcam.render.raster import RasterRenderer
from cadcam.render.view import Channel

from .sets import CAMERA, HALF, inputs_and_sampler, plan, renderer_of, scene

PLANS = {
    "bare": plan(occluders=Occluders()),
    "hidden": plan(occluders=Occluders((2, 4), size=(0.2, 0.5))),
    "cut off": plan(off_center=0.6, fill=(1.0, 2.0)),
    "lens": plan(camera=replace(CAMERA, lens=BrownConrady(-0.15, 0.02))),
    "jitter": plan(focal_jitter=0.05, center_jitter_px=4.0),
    "sensor": plan(sensor=PRESETS["global-shutter"], gray=True),
}


@pytest.fixture(scope="module", params=sorted(PLANS))
def views(request: pytest.FixtureRequest) -> list[LabelledView]:
    made = PLANS[request.param]
    inputs, sampler = inputs_and_sampler(made)
    renderer = renderer_of(inputs)
    return [renderer.view(sampler.shot(index)) for index in range(made.views)]


def test_the_mask_is_where_the_part_is_and_what_is_seen_of_it_lies_within(views: list[LabelledView]) -> None:
    for view in views:
        assert not (view.visible & ~view.mask).any()
        assert np.isfinite(view.depth[view.mask]).all()
    assert any(view.visible.any() for view in views)


def test_the_depth_of_what_is_seen_lies_on_the_part(views: list[LabelledView]) -> None:
    """Every visible pixel, taken back into the part's frame by camera, depth and pose, is a point of the box: 1e-5."""
    for view in views:
        rays = view.shot.camera.unproject(view.shot.camera.pixel_grid()[view.visible])
        points = rays / rays[:, 2:] * view.depth[view.visible][:, None].astype(float)
        own = np.abs(view.shot.camera_from_part.inv @ points) / HALF
        np.testing.assert_allclose(own.max(axis=1), 1.0, atol=1e-5)


def test_what_hides_the_part_is_in_front_of_it(views: list[LabelledView]) -> None:
    for view in views:
        hidden = view.mask & ~view.visible
        bare = renderer_of(inputs_and_sampler(plan())[0]).view(replace(view.shot, occluders=()))
        assert (view.depth[hidden] < bare.depth[hidden]).all()
        assert (view.mask == bare.mask).all()
        assert not hidden.any() or view.shot.occluders


def test_boxes_bound_the_masks(views: list[LabelledView]) -> None:
    for view in views:
        x0, y0, x1, y1 = view.whole_box
        inside = np.zeros_like(view.mask)
        inside[max(y0, 0) : y1 + 1, max(x0, 0) : x1 + 1] = True
        assert not (view.mask & ~inside).any()
        assert view.whole_count >= view.mask.sum()
        if view.whole_count == view.mask.sum() and view.mask.any():
            y, x = np.nonzero(view.mask)
            assert (x.min(), y.min(), x.max(), y.max()) == view.whole_box


def test_a_silhouette_counts_what_is_up_to_a_pictures_size_beyond_the_border(views: list[LabelledView]) -> None:
    """As BOP's own tool does it: the part alone on a canvas of three times the size."""
    width, height = CAMERA.size
    for view in views:
        wide = view.shot.camera.crop(-width, -height, (3 * width, 3 * height))
        depth = (
            RasterRenderer(scene(), threads=1).render(wide, view.shot.camera_from_part, channels=Channel.DEPTH).depth
        )
        y, x = np.nonzero(np.isfinite(depth))
        assert view.whole_count == len(x)
        assert view.whole_box == (x.min() - width, y.min() - height, x.max() - width, y.max() - height)


def test_key_points_are_where_the_camera_projects_them_and_seen_where_a_face_of_theirs_is(
    views: list[LabelledView],
) -> None:
    """Of a box without occluders a corner is seen if, and only if, one of its three faces looks at the camera."""
    points = inputs_and_sampler(plan())[0].key_points
    for view in views:
        p = points @ view.shot.camera_from_part.rotation.T + view.shot.camera_from_part.translation
        m = view.shot.camera.lens.project(p)
        K = view.shot.camera.K
        np.testing.assert_allclose(view.q, m @ K[:2, :2].T + K[:2, 2], atol=1e-9)
        inside = view.shot.camera.sees(view.q)
        assert ((view.seen == ABSENT) == ~inside).all()
        eye = view.shot.camera_from_part.origin
        shown = ((np.sign(points) * (eye - points)) > 0).any(axis=1)
        if not view.shot.occluders:
            assert (view.seen[inside] == np.where(shown, VISIBLE, HIDDEN)[inside]).all()
        else:
            assert not (view.seen[inside & ~shown] == VISIBLE).any()


def test_edges_lie_where_the_camera_projects_them(views: list[LabelledView]) -> None:
    """Through a lens they may leave the picture by the pixel to which stretches are cut."""
    for view in views:
        q = view.shot.camera.project(view.shot.camera_from_part @ view.edges.p)
        assert np.abs(q - view.edges.q).max(initial=0.0) < 1e-6
        border = np.array(view.shot.camera.size) - 0.5
        assert np.abs(view.edges.q - np.clip(view.edges.q, -0.5, border)).max(initial=0.0) < 1.0


def test_the_background_is_as_drawn_and_the_part_is_lit() -> None:
    inputs, sampler = inputs_and_sampler(plan(backgrounds=("plain",), occluders=Occluders()))
    view = renderer_of(inputs).view(sampler.shot(0))
    level = view.shot.backdrop.level
    assert (view.picture[0, 0] == np.uint8(255 * np.float32(level) + 0.5)).all()
    assert view.picture[view.mask].std() > 0


def test_quick_pictures_are_those_made_layer_by_layer() -> None:
    """A view without occluders over plain grey is drawn in one go: the same to a grey level as over any background."""
    inputs, sampler = inputs_and_sampler(plan(backgrounds=("plain",), occluders=Occluders()))
    renderer = renderer_of(inputs)
    shot = sampler.shot(1)
    part = renderer._part.render(
        shot.camera, shot.camera_from_part, look=replace(shot.look, background=(0.0, 0.0, 0.0))
    )
    slow = renderer._developed(shot, part, [], None)
    assert np.abs(slow.astype(int) - renderer.view(shot).picture).max() <= 1


def test_occluders_touch_nothing_and_stand_before_the_part() -> None:
    inputs, sampler = inputs_and_sampler(plan(40, occluders=Occluders((3, 5), size=(0.2, 0.5))))
    count = 0
    for index in range(40):
        shot = sampler.shot(index)
        spheres = [(shot.camera_from_part @ sampler.middle, sampler.radius)]
        spheres += [
            (at.camera_from_occluder @ inputs.props[at.prop].middle, inputs.props[at.prop].radius)
            for at in shot.occluders
        ]
        for i, (one, a) in enumerate(spheres):
            assert i == 0 or np.linalg.norm(one) < np.linalg.norm(spheres[0][0])
            assert all(np.linalg.norm(one - other) > a + b for other, b in spheres[:i])
        count += len(shot.occluders)
    assert count > 60


def test_a_part_wholly_out_of_view_is_an_empty_view() -> None:
    made = plan(1, poses=(Rigid(np.eye(3), np.array([900.0, 0.0, 200.0])),), occluders=Occluders())
    inputs, sampler = inputs_and_sampler(made)
    view = renderer_of(inputs).view(sampler.shot(0))
    assert not view.mask.any()
    assert (view.seen == ABSENT).all()
    assert len(view.edges) == 0


def test_topics_draw_apart_from_each_other() -> None:
    """Occluders and another background leave poses and lights as they are; another seed or view does not."""
    bare, full = (inputs_and_sampler(plan(occluders=o))[1].shot(3) for o in (Occluders(), Occluders((3, 3))))
    assert bare.camera_from_part.matrix.tobytes() == full.camera_from_part.matrix.tobytes()
    assert bare.look.fill_from == full.look.fill_from
    assert len(full.occluders) > len(bare.occluders) == 0
    for other in (inputs_and_sampler(plan(seed=6))[1].shot(3), inputs_and_sampler(plan())[1].shot(4)):
        assert other.camera_from_part.matrix.tobytes() != bare.camera_from_part.matrix.tobytes()


def test_poses_keep_to_their_range() -> None:
    around = ViewRange(np.array([1.0, 0, 0]), 30.0, np.array([0.0, 0, 1.0]), 10.0, (300.0, 400.0))
    centred = Camera.from_focal((96, 72), 110.0)
    made = plan(200, camera=centred, around=around, off_center=0.0, occluders=Occluders())
    sampler = inputs_and_sampler(made)[1]
    cosines, rolls = [], []
    for index in range(200):
        pose = sampler.shot(index).camera_from_part
        assert 300 - 1e-9 <= np.linalg.norm(pose.origin) <= 400 + 1e-9
        cosines.append(pose.origin[0] / np.linalg.norm(pose.origin))
        up = pose.rotation @ around.up
        rolls.append(np.degrees(np.arctan2(up[0], -up[1])))
    assert min(cosines) >= np.cos(np.radians(30)) - 1e-9
    assert np.quantile(cosines, 0.5) == pytest.approx(1 - (1 - np.cos(np.radians(30))) / 2, abs=0.02)
    assert max(np.abs(rolls)) <= 10 + 1e-9
    assert np.std(rolls) == pytest.approx(20 / np.sqrt(12), rel=0.15)


@pytest.mark.parametrize(
    "camera",
    [
        Camera((96, 72), np.array([[110.0, 4.0, 170.0], [0.0, 95.0, -40.0], [0.0, 0.0, 1.0]])),
        Camera((96, 72), np.array([[110.0, 0.0, 60.0], [0.0, 110.0, 20.0], [0.0, 0.0, 1.0]]), BrownConrady(k1=-0.2)),
    ],
    ids=["cut out of a larger picture", "lens"],
)
def test_the_part_is_near_the_picture_s_middle_seen_from_where_it_was_asked(camera: Camera) -> None:
    """The middle of the picture is not the camera's axis: neither in a cut-out, nor wherever the part is off centre."""
    around = ViewRange(np.array([1.0, 0, 0]), 30.0, np.array([0.0, 0, 1.0]), 10.0, (300.0, 400.0))
    made = plan(100, camera=camera, around=around, off_center=0.2, occluders=Occluders(), center_jitter_px=1.0)
    sampler = inputs_and_sampler(made)[1]
    off = []
    for index in range(100):
        shot = sampler.shot(index)
        off.append(shot.camera.project(shot.camera_from_part @ sampler.middle) - (np.array(camera.size) - 1) / 2)
        eye = shot.camera_from_part.origin - sampler.middle
        assert 300 - 1e-9 <= np.linalg.norm(eye) <= 400 + 1e-9
        assert around.allows(eye / np.linalg.norm(eye))
    most = 0.2 * 72
    assert np.abs(off).max() <= most + 1e-6  # the inverse of a lens is exact to less
    assert np.abs(off).max(axis=0) == pytest.approx([most, most], rel=0.1)


def test_where_a_lens_images_nothing_the_part_is_not_aimed() -> None:
    """A lens of small valid radius: what is asked for beyond it is at the middle."""
    camera = Camera((96, 72), np.array([[110.0, 0, 47.5], [0, 110.0, 35.5], [0, 0, 1]]), BrownConrady(k1=-1.5))
    assert np.isnan(camera.unproject([95.0, 35.5])).any()
    sampler = inputs_and_sampler(plan(40, camera=camera, off_center=1.0, occluders=Occluders()))[1]
    for index in range(40):
        assert np.isfinite(camera.project(sampler.shot(index).camera_from_part @ sampler.middle)).all()


def test_no_occluder_is_deeper_than_depths_are_counted() -> None:
    """One of CAD may be far larger than the part; of a part far beside the axis it is deeper, too."""
    large = Occluders((3, 3), shapes=(), meshes=(box([-400.0] * 3, [400.0] * 3, name="crate"),))
    beside = Rigid(np.eye(3), np.array([3000.0, 0.0, 2500.0]))
    for poses in ((), (beside,)):
        made = plan(60, poses=poses, occluders=large, around=ViewRange(distance_mm=(3000.0, 3000.0)))
        inputs, sampler = inputs_and_sampler(made)
        corners = inputs.props[0].scene.mesh.vertices
        placed = [at.camera_from_occluder for index in range(60) for at in sampler.shot(index).occluders]
        deepest = max((pose @ corners)[:, 2].max() for pose in placed)
        assert len(placed) > 30
        assert deepest <= sampler.farthest()
        assert not poses or deepest > 2500.0 + sampler.radius
