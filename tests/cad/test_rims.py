"""Rims: circles among feature edges, which STEP files draw as two arcs each."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cadcam.cad.edges import FeatureEdges
from cadcam.cad.mesh import Mesh
from cadcam.cad.parts.shape import circle
from cadcam.cad.rims import bore_of_chains, rim_centers, rim_of_chains
from cadcam.render.view import Scene

from .drawn_plate import HOLES, SIZE

PLATE = Path(__file__).resolve().parents[2] / "models/drilled_plate.step"


def drawn() -> Scene:
    pytest.importorskip("cascadio", reason='reading STEP needs the extra "step"')
    from cadcam.cad.read import read_model

    return Scene.of(read_model(PLATE))


def lines_of(runs: list[np.ndarray], parts: list[int]) -> tuple[Mesh, FeatureEdges]:
    """Return a mesh and its edges, each of the open polylines (n, 2) a chain of the part of its number."""
    count = [len(run) for run in runs]
    flat = np.concatenate(runs)
    runs_on = np.delete(np.arange(len(flat)), np.cumsum(count) - 1)
    segments = np.stack([runs_on, runs_on + 1], axis=1)
    chain = np.repeat(np.arange(len(runs)), np.subtract(count, 1))
    none = np.zeros(1, np.int32)
    mesh = Mesh(np.column_stack([flat, 0 * flat[:, 0]]), np.array([[0, 1, 2]]), none, none - 1, ("a",), np.ones((1, 3)))
    return mesh, FeatureEdges(segments, np.zeros_like(segments), np.zeros_like(chain), chain, np.array(parts)[chain])


def test_two_halves_of_a_rim_are_one_rim() -> None:
    scene = drawn()
    rim = rim_of_chains(scene.mesh, scene.edges)
    chains = len(np.unique(scene.edges.chain))
    assert len(rim) == chains
    assert len(np.unique(rim)) == chains - 2 * len(HOLES)  # one above and one below each
    first, halves = np.unique(rim, return_counts=True)
    assert sorted(halves.tolist())[-2 * len(HOLES) :] == [2] * 2 * len(HOLES)
    lines = scene.edges.polylines(scene.mesh)
    for k in first[halves == 2]:
        one, other = (lines[c] for c in np.flatnonzero(rim == k))
        assert {tuple(p) for p in (one[0], one[-1])} == {tuple(p) for p in (other[0], other[-1])}


def test_what_runs_on_smoothly_but_not_round_is_no_rim_nor_are_halves_of_different_parts() -> None:
    """A slot's ends and sides have each their own number; so have a half circle and one on another part."""
    ring = np.vstack([p := circle((0.0, 0.0), 5.0, 64), p[:1]])
    high, low = ring[:33], ring[32:]
    across = np.array([[-5.0, 0.0], [-5.0, -20.0]]), np.array([[5.0, -20.0], [5.0, 0.0]])
    slot = [high, across[0], low - (0, 20), across[1]]
    assert rim_of_chains(*lines_of(slot, [0, 0, 0, 0])).tolist() == [0, 1, 2, 3]
    assert rim_of_chains(*lines_of([across[0], high, low[::-1]], [0, 0, 0])).tolist() == [0, 1, 1]  # where two meet
    assert rim_of_chains(*lines_of([across[0] + 30, high, low[::-1]], [0, 0, 0])).tolist() == [0, 1, 1]
    assert rim_of_chains(*lines_of([across[0] + 30, high, low[::-1]], [0, 0, 1])).tolist() == [0, 1, 2]


def test_rims_of_holes_that_are_drawn_by_halves_have_middles() -> None:
    scene = drawn()
    middles = rim_centers(scene.mesh, scene.edges)
    expected = {(x, y, z) for x, y, _ in HOLES.values() for z in (0.0, SIZE[2])}
    assert {tuple(p) for p in np.round(middles, 3).tolist()} == expected


def test_all_rims_of_a_hole_are_one_bore() -> None:
    """Four half rims each; what is no rim, and rims of other holes, have numbers of their own."""
    scene = drawn()
    bore = bore_of_chains(scene.mesh, scene.edges)
    number, chains = np.unique(bore, return_counts=True)
    assert sorted(chains.tolist())[-len(HOLES) :] == [4] * len(HOLES)
    assert chains.sum() - 4 * len(HOLES) == len(number) - len(HOLES)
    lines = scene.edges.polylines(scene.mesh)
    for k in number[chains == 4]:
        places = np.concatenate([lines[c] for c in np.flatnonzero(bore == k)])
        middle = (places.min(axis=0) + places.max(axis=0)) / 2
        assert min(np.hypot(*(middle[:2] - hole[:2])) for hole in HOLES.values()) < 1e-3
        assert np.ptp(places[:, 2]) == pytest.approx(SIZE[2])


def test_a_step_in_a_hole_makes_two_bores() -> None:
    """Circles about one axis, of which one is a tenth larger; and two of one size side by side."""
    rings = [circle((0.0, 0.0), 5.0, 32), circle((0.0, 0.0), 5.5, 32), circle((20.0, 0.0), 5.0, 32)]
    mesh, edges = lines_of([np.vstack([ring, ring[:1]]) for ring in rings], [0, 0, 0])
    assert bore_of_chains(mesh, edges).tolist() == [0, 1, 2]
