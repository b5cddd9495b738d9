"""The demo's block as built, with deviations from its design: its photo, and the true values."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np

from cadcam.arrays import Array, Picture
from cadcam.cad.mesh import Mesh, merge
from cadcam.camera.camera import Camera
from cadcam.camera.lens import BrownConrady
from cadcam.camera.observations import Observations
from cadcam.cli.demo.inputs import hall
from cadcam.geometry.rigid import Rigid
from cadcam.render.light import Lamp, Light

# A machine-vision camera, held into the block from its open side some 2 m from the bracket.
CLOSE_CAMERA = Camera(
    (1200, 900), np.array([[1498.6, 0.9, 607.3], [0.0, 1497.0, 446.2], [0.0, 0.0, 1.0]]), BrownConrady(k1=-0.09)
)
SEEN = np.array([1800.0, 800.0, 300.0])  # about the middle of its field of view
CLOSE_POSE = Rigid.look_at([900, -1100, 2300], SEEN)
START = Rigid.look_at([800, -1000, 2300], [1900, 800, 300])  # the assumed pose of the camera
MARKS_POSE, MARK_SIGMA_PX = Rigid.look_at([420, 1250, 1600], [310, 200, 200]), 0.05
LIGHT = Light((Lamp((0.35, -0.55, 1.0), 0.65, 2.0),), flash=0.75, ambient=0.25)  # under the roof, and at the camera
SAMPLES = 8  # renderings averaged for the photo

DISPLACED, DISPLACED_BY = "bracket 2.1 port", (0.0, 6.0, 0.0)
FORGOTTEN, AS_DRAWN = "longitudinal 2 port", "longitudinal 1 port"
TOLERANCES = f"""\
# What the block is judged by: mm, in its own axes. The pose is fitted to all that is not judged here.
k: 2                        # U = k sigma
features:
  bracket:
    part: {DISPLACED}
    position_mm: 3
    direction: [0, 1, 0]    # it stands on floor and tank top, and can only be off to the side
  outer longitudinal:
    part: {AS_DRAWN}
    position_mm: 3
    direction: [0, 1, 0]
  inner longitudinal:
    part: {FORGOTTEN}
    presence: required
"""


def steel_of(block: Mesh) -> Mesh:
    """Return the block before its pipe is mounted."""
    return block.subset([name for name in block.part_names if "pipe" not in name and "flange" not in name])


def as_built(steel: Mesh) -> Mesh:
    """Return the steel with one part displaced and without another."""
    vertices = steel.vertices.copy()
    vertices[np.unique(steel.faces[steel.part == steel.part_names.index(DISPLACED)])] += DISPLACED_BY
    return replace(steel, vertices=vertices).select(steel.part != steel.part_names.index(FORGOTTEN))


def seen_marks(rng: np.random.Generator) -> Observations:
    """Return the marks of a calibration angle, two plates of 7 x 6, as imaged by the close camera."""
    lying = np.array([(100.0 * i, 100.0 * j, 0.0) for i, j in product(range(7), range(6))])
    standing = np.array([(100.0 * i, 0.0, 100.0 * (j + 1)) for i, j in product(range(7), range(6))])
    p = np.concatenate([lying, standing])
    q = CLOSE_CAMERA.project(MARKS_POSE @ p)
    q = np.round(q + rng.normal(scale=MARK_SIGMA_PX, size=q.shape), 3)
    names = tuple(f"{plate} {i}.{j}" for plate in ("lying", "standing") for i, j in product(range(1, 8), range(1, 7)))
    return Observations(p, q, names)


def made_photo(steel: Mesh, rng: np.random.Generator) -> Picture:
    """Return a photo of the block as built, in its hall: soft shadows, a flash, the noise of a sensor."""
    from cadcam.cli.wires import scene_without_edges
    from cadcam.image.picture import to_gray
    from cadcam.image.sensor.presets import preset
    from cadcam.render.photograph import Photographer

    photographer = Photographer(scene_without_edges(merge([as_built(steel), *hall()])))
    light = photographer.radiance(CLOSE_CAMERA, CLOSE_POSE, light=LIGHT, blur_px=0.5, samples=SAMPLES)
    return preset("global-shutter").apply(to_gray(light.over((0.3, 0.3, 0.3))), rng=rng)


def start_text() -> str:
    """Return the file of the start."""
    rows = "\n".join("  ".join(f"{x:12.6f}" for x in row) for row in START.matrix[:3].tolist())
    return f"# camera_from_part, mm\n{rows}\n"


def start_off() -> tuple[float, float]:
    """Return how far the start is from the truth: mm at the middle of what is seen, and degrees."""
    apart = CLOSE_POSE.inv @ START
    moved = np.linalg.norm(apart @ SEEN - SEEN)
    return float(moved), float(np.degrees(np.linalg.norm(apart.log()[3:])))


def true_position(feature: str) -> float:
    """Return the displacement of a feature of the tolerance file from its design along y, mm."""
    return DISPLACED_BY[1] if feature == "bracket" else 0.0


def position_in_part(camera_from_part: Rigid, covariance: Array) -> tuple[Array, Array]:
    """Return the position of the camera (3,) in the part's axes, and sigmas; covariance (6, 6): xi in T @ exp(xi)."""
    from cadcam.geometry.rotation import hat

    p = camera_from_part.inv.translation
    by_xi = np.column_stack([-np.eye(3), hat(p)])
    return p, np.sqrt(np.diag(by_xi @ covariance @ by_xi.T))
