"""Sensor options of verbs that make pictures, and the random generator of their noise."""

from __future__ import annotations

import argparse
import os
from pathlib import Path
from typing import TYPE_CHECKING

from cadcam.cli.arguments import seed

if TYPE_CHECKING:
    from numpy.random import Generator


def add_sensor_options(parser: argparse.ArgumentParser) -> None:
    """Add --sensor and --seed, for verbs that make pictures."""
    group = parser.add_argument_group("sensor")
    group.add_argument(
        "--sensor", metavar="PROFILE", help="what the camera does to the picture: a file or a preset (`cadcam sensor`)"
    )
    group.add_argument("--seed", type=seed, metavar="N", help="seed of its noise (default: 0)")


def generator(start: int, path: str | None = None) -> Generator:
    """Return the random generator of --seed, for one of many pictures by its file's name."""
    import zlib

    import numpy as np

    return np.random.default_rng([start] if path is None else [start, zlib.crc32(os.fsencode(Path(path).name))])
