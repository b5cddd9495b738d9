"""Rays come nearest where no neighbour is nearer; planes meet them on both."""

from __future__ import annotations

import numpy as np
import pytest

from cadcam.errors import BadValue, DegenerateGeometry
from cadcam.geometry.plane import Plane
from cadcam.geometry.ray import Ray, nearest_to_all

EPS = np.finfo(float).eps
BATCHES = [(), (1,), (5,), (2, 3)]


def random_rays(rng: np.random.Generator, batch: tuple[int, ...], d: int = 3) -> Ray:
    return Ray(rng.normal(size=(*batch, d)) * 100, rng.normal(size=(*batch, d)))


@pytest.mark.parametrize("batch", BATCHES)
def test_the_shortest_connection_is_perpendicular_to_both_rays(
    rng: np.random.Generator, batch: tuple[int, ...]
) -> None:
    one, two = random_rays(rng, batch), random_rays(rng, batch)
    near = one.approach(two)
    link = near.feet[..., 1, :] - near.feet[..., 0, :]
    reach = np.abs(near.feet).max() / np.sin(near.angle).min()
    for ray in (one, two):
        assert np.abs(np.sum(link * ray.direction, axis=-1)).max() < 50 * EPS * reach / np.sin(near.angle).min()
    assert near.feet[..., 0, :] == pytest.approx(one.at(near.along[..., 0]), abs=0)


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("batch", BATCHES)
def test_the_point_nearest_to_two_rays_is_the_middle_of_their_shortest_connection(
    rng: np.random.Generator, batch: tuple[int, ...], d: int
) -> None:
    one, two = random_rays(rng, batch, d), random_rays(rng, batch, d)
    both = Ray(np.stack([one.origin, two.origin], axis=-2), np.stack([one.direction, two.direction], axis=-2))
    near = one.approach(two)
    assert nearest_to_all(both) == pytest.approx(near.point, abs=1e4 * EPS * np.abs(near.feet).max())
    if d == 2:
        assert near.gap == pytest.approx(np.zeros(batch), abs=1e4 * EPS * np.abs(near.feet).max())


def test_rays_through_one_point_come_nearest_there(rng: np.random.Generator) -> None:
    p = np.array([12.0, -30.0, 400.0])
    origin = rng.normal(size=(6, 3)) * 300
    assert nearest_to_all(Ray(origin, p - origin)) == pytest.approx(p, abs=1e3 * EPS * 500)


def test_no_neighbour_of_the_nearest_point_is_nearer_to_all_rays(rng: np.random.Generator) -> None:
    rays = random_rays(rng, (5,))
    best = nearest_to_all(rays)
    least = np.sum(rays.distance(best) ** 2)
    for step in np.concatenate([np.eye(3), -np.eye(3)]) * 1e-3:
        assert np.sum(rays.distance(best + step) ** 2) > least


def test_nearly_parallel_rays_keep_their_digits() -> None:
    """An angle of 1e-6: a cosine would know its sine to 1e-4 only; here the distance keeps nine digits."""
    angle = 1e-6
    one, two = Ray([0.0, 0, 0], [0.0, 0, 1]), Ray([1e-3, 0.5, 0], [-np.sin(angle), 0, np.cos(angle)])
    near = one.approach(two)
    assert near.along[0] == pytest.approx(1e-3 / np.tan(angle), rel=1e-9)
    assert near.angle == pytest.approx(angle, rel=1e-9)
    assert near.gap == pytest.approx(0.5, rel=1e-9)


def test_parallel_rays_have_no_nearest_point() -> None:
    one, two = Ray([0.0, 0, 0], [1.0, 2, 3]), Ray([5.0, 0, 0], [2.0, 4, 6])
    both = Ray([[0.0, 0, 0], [5.0, 0, 0]], [[1.0, 2, 3], [1.0, 2, 3]])
    assert np.isnan(one.approach(two).point).all()
    assert np.isnan(nearest_to_all(both)).all()


def test_a_foot_behind_the_origin_counts_negative() -> None:
    ray = Ray([0.0, 0, 10], [0.0, 0, 3])
    assert ray.along([1.0, 0, 4]) == -6
    assert ray.distance([3.0, 4, 99]) == 5


@pytest.mark.parametrize(("origin", "direction"), [([0.0, 0, 0], [0.0, 0, 0]), ([0.0, 0], [1.0, 0, 0]), ([0.0], [1.0])])
def test_what_is_not_a_ray_is_refused(origin: list[float], direction: list[float]) -> None:
    with pytest.raises(BadValue):
        Ray(origin, direction)


@pytest.mark.parametrize("batch", BATCHES)
def test_a_ray_meets_a_plane_on_both(rng: np.random.Generator, batch: tuple[int, ...]) -> None:
    plane = Plane.through(rng.normal(size=(*batch, 3)) * 100, rng.normal(size=(*batch, 3)))
    rays = random_rays(rng, batch)
    rays = Ray(
        rays.origin,
        rays.direction
        * -np.sign(plane.distance(rays.origin) * np.sum(rays.direction * plane.normal, axis=-1))[..., None],
    )
    met = plane.meet(rays)
    scale = np.abs(met).max() + 1000
    assert np.abs(plane.distance(met)).max() < 50 * EPS * scale
    assert rays.distance(met).max() < 50 * EPS * scale


def test_a_plane_behind_a_ray_or_along_it_is_not_met() -> None:
    plane = Plane([0.0, 0, 2], 10.0)
    assert plane.offset == 5
    rays = Ray(np.zeros((3, 3)), [[0.0, 0, 1], [0, 0, -1], [1, 0, 0]])
    assert np.isnan(plane.meet(rays)).tolist() == [[False] * 3, [True] * 3, [True] * 3]


def test_the_plane_of_points_is_the_one_they_lie_on(rng: np.random.Generator) -> None:
    truth = Plane([0.2, -0.3, 0.9], 123.0)
    p = np.array([40.0, 5, 120]) + rng.normal(size=(12, 2)) @ truth.basis.T * 50
    p = truth.foot(p)
    found = Plane.from_points(p)
    assert found.normal == pytest.approx(truth.normal, abs=1e-13)
    assert found.offset == pytest.approx(float(truth.offset), abs=1e-10)
    assert truth.basis.T @ truth.basis == pytest.approx(np.eye(2), abs=4 * EPS)
    assert truth.normal @ truth.basis == pytest.approx(np.zeros(2), abs=4 * EPS)


@pytest.mark.parametrize("points", [[[0, 0, 0], [1, 1, 1]], [[0, 0, 0], [1, 1, 1], [2, 2, 2]], [[1, 2, 3]] * 4])
def test_points_on_a_line_give_no_plane(points: list[list[float]]) -> None:
    with pytest.raises(DegenerateGeometry, match="no plane"):
        Plane.from_points(points)


def test_points_of_another_shape_and_other_things_than_rays_are_refused() -> None:
    ray, plane = Ray([0.0, 0, 0], [1.0, 0, 0]), Plane([0.0, 0, 1], 0.0)
    for call in (plane.distance, plane.foot, ray.along, ray.foot, ray.distance):
        for wrong in ([1.0, 2.0], "here"):
            with pytest.raises(BadValue, match=r"points is .*\(\.\.\., 3\)"):
                call(wrong)
    with pytest.raises(BadValue, match="rays"):
        plane.meet([0.0, 0, 1])  # type: ignore[arg-type]
    with pytest.raises(BadValue, match="other"):
        ray.approach([0.0, 0, 1])  # type: ignore[arg-type]
    assert plane.single
    assert not Plane(np.eye(3), np.zeros(3)).single
