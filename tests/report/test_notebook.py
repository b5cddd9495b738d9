"""In a notebook results are shown as the tables and pictures that reports have."""

from __future__ import annotations

import io
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from PIL import Image

import cadcam
from cadcam.cad.parts.shape import box
from cadcam.report.camera import parameter_table

CAMERA = cadcam.Camera.from_focal((1200, 900), 1350.0)
POSE = cadcam.Rigid.look_at((700, -500, 600), (150, 100, 50))
P = np.random.default_rng(3).uniform(-200, 200, (12, 3))


class Formatter(dict[type, Callable[[Any], Any]]):
    """What IPython has for one kind of output."""

    def for_type(self, kind: type, how: Callable[[Any], Any]) -> None:
        self[kind] = how


@pytest.fixture
def shown() -> Callable[[object], Any]:
    """Return what a notebook shows of a result."""
    formatters = {"text/html": Formatter(), "image/png": Formatter()}
    cadcam.load_ipython_extension(SimpleNamespace(display_formatter=SimpleNamespace(formatters=formatters)))
    ways = {**formatters["text/html"], **formatters["image/png"]}
    return lambda result: ways[type(result)](result)


def test_a_calibration_shows_its_parameters_with_sigmas_and_units(shown: Callable[[object], str]) -> None:
    q = CAMERA.project(cadcam.Rigid.look_at((0, -900, 400), (0, 0, 0)) @ P)
    points = cadcam.Observations(P, q + 0.1 * np.sin(np.arange(24)).reshape(12, 2))
    estimate = cadcam.calibrate_camera(points, CAMERA.size)
    html = shown(estimate)
    assert html.count("<tr>") == 1 + len(parameter_table(estimate).rows)
    for said in ("focal", "sigma", "px", "mm", "deg"):
        assert said in html


def test_where_a_part_is_shows_with_what_speaks_for_it(shown: Callable[[object], str]) -> None:
    html = shown(cadcam.Location.nowhere(POSE, "quality <0.5> & nothing else"))
    assert "quality &lt;0.5&gt; &amp; nothing else" in html
    assert "origin in the world, mm" in html
    pose = shown(cadcam.PoseEstimate(POSE, np.diag([0.01, 0.04, 0.09, 1e-6, 1e-6, 1e-6])))
    assert ">0.1, 0.2, 0.3<" in pose
    assert ">0.057, 0.057, 0.057<" in pose  # 1 mrad in degrees


def test_pictures_are_no_wider_than_a_notebook(shown: Callable[[object], bytes]) -> None:
    scene = cadcam.Scene.of(box((0, 0, 0), (300, 200, 100), name="box"))
    view = cadcam.open_renderer(scene).render(CAMERA, POSE)
    lines = cadcam.visible_wireframe(scene, CAMERA, POSE)
    photo = cadcam.Photo.of(cadcam.to_gray(view.image), CAMERA, POSE)
    for result in (view, lines, photo):
        with Image.open(io.BytesIO(shown(result))) as picture:
            assert picture.size == (960, 720)
            darkest, brightest = picture.convert("L").getextrema()
            assert brightest - darkest > 50


def test_a_view_without_a_picture_is_not_shown_as_one(shown: Callable[[object], bytes | None]) -> None:
    scene = cadcam.Scene.of(box((0, 0, 0), (300, 200, 100), name="box"))
    assert shown(cadcam.open_renderer(scene).render(CAMERA, POSE, channels=cadcam.Channel.DEPTH)) is None
