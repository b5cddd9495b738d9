"""What is wrong in the wrong cases of benchmarks/locate_battery.py: models, cameras, pictures and starts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from cadcam.arrays import Array, Picture
from cadcam.cad.mesh import Mesh
from cadcam.cad.parts.shape import box, circle, extruded, filled
from cadcam.camera.camera import Camera
from cadcam.camera.lens import BrownConrady, Ideal
from cadcam.geometry.rigid import Rigid

BAY, BAYS = 25.0, 9  # mm, and number, of the bays of a rack
_FLANGE = ((-6, -14), (14, -14), (14, -6), (-6, -6))  # mm, corners of the slot

Model = Callable[[Mesh, np.random.Generator], Mesh]
Told = Callable[[Camera, np.random.Generator], Camera]


def flange(holes: int = 6, pitch_radius: float = 34.0, hole_radius: float = 4.5, turn_deg: float = 0.0) -> Mesh:
    """Return a plate with a ring of holes and a rim, and a slot that leaves it one pose only."""
    angles = np.radians(turn_deg) + 2 * np.pi * np.arange(holes) / holes
    round_ = [circle((pitch_radius * np.cos(a), pitch_radius * np.sin(a)), hole_radius, 96) for a in angles]
    plate = [filled(circle((0, 0), 46, 384), [*round_, np.array(_FLANGE, float)])]
    ring = [filled(circle((0, 3), 20, 256), [circle((0, 3), 15, 256)])]
    return _merged(extruded(plate, 0, 9, name="flange", color=None), extruded(ring, 9, 26, name="rim", color=None))


def rack() -> Mesh:
    """Return a rail with equal slots and a heel at one end: shifted by a bay, all but its ends looks the same."""
    length = BAY * BAYS
    slots = [
        np.array([(x - 6, 10), (x + 6, 10), (x + 6, 30), (x - 6, 30)], float)
        for x in BAY * (np.arange(BAYS) + 0.5) - length / 2
    ]
    outline = np.array([(-length / 2, 0), (length / 2, 0), (length / 2, 40), (-length / 2, 40)], float)
    rail = extruded([filled(outline, slots)], 0, 8, name="rail", color=None)
    heel = box((-length / 2, 0, 8), (-length / 2 + 10, 40, 20), name="heel")
    return _merged(rail, heel)


def stretched(least: float, most: float) -> Model:
    """Return what makes a model longer or shorter along one of its axes, by a share drawn from least to most."""

    def model(mesh: Mesh, rng: np.random.Generator) -> Mesh:
        factors = np.ones(3)
        factors[rng.integers(3)] += rng.choice([-1, 1]) * rng.uniform(least, most)
        middle = mesh.bounds.mean(axis=0)
        return _moved(mesh, middle + (mesh.vertices - middle) * factors)

    return model


def lengthened(least: float, most: float) -> Model:
    """Return what moves one end of a model, all beyond the middle of its longest side, as a variant has it."""

    def model(mesh: Mesh, rng: np.random.Generator) -> Mesh:
        axis = int(np.argmax(mesh.size_mm))
        by = rng.choice([-1, 1]) * rng.uniform(least, most) * mesh.size_mm[axis]
        beyond = mesh.vertices[:, axis] > mesh.bounds[:, axis].mean() + abs(by)
        return _moved(mesh, mesh.vertices + np.outer(beyond, by * np.eye(3)[axis]))

    return model


def other_holes(mesh: Mesh, rng: np.random.Generator) -> Mesh:
    """Return the flange with another ring of holes: turned, one more or less, or on another circle."""
    turned, fewer, more = partial(flange, turn_deg=30.0), partial(flange, holes=5), partial(flange, holes=8)
    return [turned, fewer, more, partial(flange, pitch_radius=29.0)][int(rng.integers(4))]()


def focal(least: float, most: float) -> Told:
    """Return what tells a camera with a focal length off by a share drawn from least to most."""

    def told(camera: Camera, rng: np.random.Generator) -> Camera:
        K = camera.K.copy()
        K[:2, :2] *= 1 + rng.choice([-1, 1]) * rng.uniform(least, most)
        return Camera(camera.size, K, camera.lens)

    return told


def other_lens(camera: Camera, rng: np.random.Generator) -> Camera:
    """Return a camera with a lens that the true one, of no distortion or of some, does not have."""
    lens = BrownConrady(float(rng.choice([-0.35, 0.3]))) if isinstance(camera.lens, Ideal) else Ideal()
    return Camera(camera.size, camera.K, lens)


def other_size(camera: Camera, rng: np.random.Generator) -> Camera:
    """Return the camera of a larger picture, of which this one was thought to be the upper left part."""
    K = camera.K.copy()
    K[:2, 2] += 0.125 * np.array(camera.size)
    return Camera(camera.size, K, camera.lens)


def upside_down(taken: Picture) -> Picture:
    """Return a picture turned by 180 degrees."""
    return taken[::-1, ::-1]


def mirrored(taken: Picture) -> Picture:
    """Return a picture left for right."""
    return taken[:, ::-1]


def blurred(sigma: float) -> Callable[[Picture], Picture]:
    """Return what blurs a picture by a Gaussian, px."""
    from scipy.ndimage import gaussian_filter

    return lambda taken: np.asarray(gaussian_filter(taken, sigma, axes=(0, 1)))


def saturated(taken: Picture) -> Picture:
    """Return a picture of which most is white."""
    return np.asarray(np.clip(5 * taken, 0, 1))


def one_bay_off(start: Rigid, rng: np.random.Generator) -> Rigid:
    """Return a start one bay of the rack off."""
    return start @ Rigid(translation=np.array([rng.choice([-1, 1]) * BAY, 0.0, 0.0]))


def beside(mesh: Mesh, rng: np.random.Generator) -> Rigid:
    """Return where a second part of the same kind stands, turned about the upright (z) and clear of the first."""
    turn = Rigid.exp(np.array([0, 0, 0, 0, 0, rng.uniform(-np.pi, np.pi)]))
    reach = float(np.hypot(*mesh.size_mm[:2]))
    angle = rng.uniform(0, 2 * np.pi)
    middle = np.append(mesh.bounds.mean(axis=0)[:2], 0.0)
    return (
        Rigid(translation=middle + 1.05 * reach * np.array([np.cos(angle), np.sin(angle), 0.0]))
        @ turn
        @ Rigid(translation=-middle)
    )


def _moved(mesh: Mesh, vertices: Array) -> Mesh:
    return replace(mesh, vertices=vertices, corner_normals=None)


def _merged(*meshes: Mesh) -> Mesh:
    from cadcam.cad.mesh import merge

    return merge(list(meshes))
