"""A small scene: an open box on a table, cameras on a ring around it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

import cadcam
from cadcam.cad.mesh import Mesh, merge
from cadcam.cad.parts.shape import box
from cadcam.camera.sensor_format import sensor_format
from cadcam.plan.scene.feature import Kind, LayoutFeature
from cadcam.plan.scene.layout_scene import CameraType, LayoutScene, Mount, Sigmas
from cadcam.plan.uncertainty.finding import Finder
from cadcam.verify.tolerances.tolerance import Limit, Quantity

COLOR = (0.5, 0.5, 0.5)
MIDDLE = np.array([200.0, 150.0, 60.0])


def part() -> Mesh:
    """Return a floor of 400 x 300 mm with a wall across it and a post."""
    return merge(
        [
            box((0, 0, 0), (400, 300, 10), name="floor", color=COLOR),
            box((180, 40, 10), (190, 300, 120), name="wall", color=COLOR),
            box((300, 100, 10), (330, 130, 90), name="post", color=COLOR),
        ]
    )


def position(value: float, direction: Any = None) -> tuple[Limit, ...]:
    return (Limit(Quantity.POSITION, value, direction=direction),)


def features() -> tuple[LayoutFeature, ...]:
    """Return marks on the floor and the wall, an edge with a direction, and a corner."""
    up, back = np.array([0.0, 0, 1]), np.array([-1.0, 0, 0])
    edge = np.array([[20.0, 0, 10], [380, 0, 10]])
    return (
        LayoutFeature("left", Kind.CIRCLE, np.array([60.0, 80, 10]), position(0.2), normal=up, diameter_mm=12.0),
        LayoutFeature("right", Kind.CIRCLE, np.array([260.0, 60, 10]), position(0.2), normal=up, diameter_mm=12.0),
        LayoutFeature("wall", Kind.CIRCLE, np.array([180.0, 170, 70]), position(0.3), normal=back, diameter_mm=15.0),
        LayoutFeature("top", Kind.POINT, np.array([315.0, 115, 90]), position(0.2, np.array([0.0, 0, 1])), normal=up),
        LayoutFeature.edge("front", edge, (*position(0.2), Limit(Quantity.ANGLE, 2e-3))),
    )  # fmt: skip


def ring(n: int, *, radius: float = 900.0, height: float = 700.0) -> Mount:
    angle = np.linspace(0, 2 * np.pi, n, endpoint=False) + 0.1
    eyes = MIDDLE + np.column_stack([radius * np.cos(angle), radius * np.sin(angle), np.full(n, height)])
    return Mount("ring", eyes, np.tile(MIDDLE, (n, 1)), ("cam",))


def scene(n: int = 12, **changes: Any) -> LayoutScene:
    """Return the scene with n candidates and what else is changed."""
    made = LayoutScene(
        part=part(),
        poses={
            "here": cadcam.Rigid(),
            "there": cadcam.Rigid.exp([15.0, -10.0, 0.0, 0.0, 0.0, np.radians(8.0)]),
        },
        cameras={"cam": CameraType("cam", sensor_format("IMX264"), 16.0, 8.0)},
        mounts=(ring(n),),
        features=features(),
        finder=Finder(sigma_px=0.05),
        calibration=Sigmas(0.03, 3e-5, 0.2, 0.3),
        motion=Sigmas(0.05, 5e-5),
        choose=3,
    )
    return replace(made, **changes)
