"""A small part with its plan, and data sets as bytes."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from cadcam.cad.parts.shape import box
from cadcam.camera.camera import Camera
from cadcam.dataset.key_points import corners
from cadcam.dataset.plan import NOISE, PLAIN, DatasetPlan, Occluders, middle_and_radius
from cadcam.dataset.props import props_of
from cadcam.dataset.shot import ShotSampler
from cadcam.dataset.view_renderer import ViewInputs, ViewRenderer
from cadcam.render.lines.seen import drawable_edges
from cadcam.render.view import Scene

HALF = np.array([30.0, 20.0, 10.0])  # the part is a box about its origin
CAMERA = Camera.from_focal((96, 72), 110.0, cx=46.0, cy=37.0)


@cache
def scene() -> Scene:
    return Scene.of(box((-HALF).tolist(), HALF.tolist(), name="block", color=(0.6, 0.5, 0.4)))


def plan(views: int = 8, **changed: Any) -> DatasetPlan:
    """A plan with something of everything."""
    how: dict[str, Any] = {"seed": 5, "backgrounds": (PLAIN, NOISE), "occluders": Occluders((0, 3)), "fill": (0.5, 1.5)}
    return DatasetPlan(**({"views": views, "camera": CAMERA} | how | changed))


def inputs_and_sampler(of: DatasetPlan, part: Scene | None = None) -> tuple[ViewInputs, ShotSampler]:
    part = part or scene()
    props = props_of(of.occluders, 2 * middle_and_radius(part.mesh)[1], of.seed)
    points = corners(part)[1] if of.key_points is None else of.key_points
    return ViewInputs(part, props, points, of.sensor, of.gray, 0.05), ShotSampler(of, part, props)


def renderer_of(inputs: ViewInputs) -> ViewRenderer:
    return ViewRenderer(inputs, drawable_edges(inputs.scene))


def contents(folder: Path) -> dict[str, bytes]:
    """Return every file below a folder with its bytes."""
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def same(one: Path, other: Path) -> None:
    """Assert that two folders hold the same files with the same bytes, naming the first that differs."""
    a, b = contents(one), contents(other)
    assert sorted(a) == sorted(b)
    assert [name for name in a if a[name] != b[name]] == []
