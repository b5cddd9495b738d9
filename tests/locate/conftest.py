"""The bracket that several tests of locating look for, and a pose of it."""

from __future__ import annotations

import pytest

from cadcam.cad.parts.bracket import machined_bracket
from cadcam.geometry.rigid import Rigid
from cadcam.locate.part import Part

from .photos import view


@pytest.fixture(scope="module")
def part() -> Part:
    return Part.of(machined_bracket())


@pytest.fixture(scope="module")
def pose(part: Part) -> Rigid:
    return view(part, (0.7, -0.9, 0.8))
