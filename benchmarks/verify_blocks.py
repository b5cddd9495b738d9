"""The parts common to verify.py and verify_shadows.py: blocks that deviate from their CAD, results on their bodies."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Collection, Mapping
from dataclasses import replace
from functools import lru_cache
from typing import TypeVar

import numpy as np

from cadcam.arrays import Array
from cadcam.cad.mesh import Mesh
from cadcam.geometry.rigid import Rigid
from cadcam.locate.part import Part
from cadcam.verify.deviations.deviation import FeatureDeviation, State
from cadcam.verify.inspection import Inspection
from cadcam.verify.judge import judged
from cadcam.verify.tolerances.tolerance import Feature, Limit, Selection
from cadcam.verify.tolerances.verdict import Verdict

T = TypeVar("T")


@lru_cache(maxsize=1)
def drawn(block: Mesh) -> Part:
    """Return the part of a block as drawn, its lines made: a plant has them from the day before."""
    part = Part.of(block)
    _ = part.lines
    return part


def built(block: Mesh, moved: Mapping[str, Array], gone: Collection[str]) -> Mesh:
    """Return the block with bodies moved by vectors (3,) mm, and without others."""
    vertices, kept = block.vertices.copy(), np.ones(block.n_faces, bool)
    for name, by in moved.items():
        vertices[np.unique(block.faces[block.part == block.part_names.index(name)])] += by
    for name in gone:
        kept &= block.part != block.part_names.index(name)
    return replace(block, vertices=vertices).select(kept)


def across(camera_from_part: Rigid, size_mm: float, rng: np.random.Generator) -> Array:
    """Return a displacement (3,) of so many mm, at random across the line of sight."""
    way = rng.normal(size=3)
    way -= camera_from_part.rotation[2] * (camera_from_part.rotation[2] @ way)
    return np.asarray(size_mm * way / np.linalg.norm(way))


def blamed(f: FeatureDeviation) -> bool:
    """Return whether a body is called displaced or missing."""
    return f.state in (State.DISPLACED, State.MISSING)


def verdict(seen: Inspection, name: str, limit: Limit) -> Verdict:
    """Return the verdict on one limit of a body."""
    return judged(Feature(name, Selection(name), (limit,)), seen)[0].verdict


def in_words(f: FeatureDeviation) -> str:
    """Return what is said of a body, and on what evidence."""
    said = f"{f.presence.seen}/{f.presence.expected} edges, L {f.presence.log_ratio:.1f}, p {f.p_value:.1g}"
    return f"{f.state.value}, {f.size:.2f} +- {f.sigma:.2f} mm, {said}"


def table(
    doc: str | None,
    head: str,
    cases: Collection[str],
    pictures: int,
    study: Callable[[str, int, int], T],
    row: Callable[[str, T], str],
) -> None:
    """Print a table with a row for each case that the command line asks for."""
    parser = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pictures", type=int, default=pictures)
    parser.add_argument("--case", action="append", choices=cases)
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    print(f"{head}\n|{'---|' * head.count(' | ')}---|")
    for case in arguments.case or cases:
        print(row(case, study(case, arguments.pictures, arguments.seed)), flush=True)
