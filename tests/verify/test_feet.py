"""Lines where a body stands on another: how they slide when it sinks."""

from __future__ import annotations

import numpy as np

from cadcam.cad.edges import EdgeKind
from cadcam.geometry.rigid import Rigid
from cadcam.locate.photo import Photo
from cadcam.verify.edges.feet import Feet
from cadcam.verify.edges.shown import ShownFaces
from cadcam.verify.edges.sightlines import sightlines
from cadcam.verify.edges.surroundings import edge_surroundings

from .scene import CAMERA, POSE, part, photo, plate


def seen_at(q: np.typing.NDArray[np.float64]) -> np.typing.NDArray[np.float64]:
    return CAMERA.project(POSE @ q)


def test_a_foot_is_a_contact_line_beside_the_body_it_stands_on(rng: np.random.Generator) -> None:
    """The ribs, the block and the bracket stand on the plate; nothing else is a foot of theirs."""
    shot: Photo = photo(plate(), rng)
    lines, _ = sightlines(part(), [shot], Rigid())
    feet = Feet.of(lines, edge_surroundings([shot], [ShownFaces.of(part(), shot, Rigid())], lines))
    standing = feet.mate >= 0
    assert standing.sum() > 30
    assert (lines.kind[standing] == EdgeKind.CONTACT).all()
    assert set(feet.mate[standing]) == {plate().part_names.index("plate")}
    np.testing.assert_allclose(lines.p[standing, 2], 12.0, atol=1e-6)  # the plate's upper side
    assert not feet.lever[~standing].any()


def test_a_foot_slides_up_the_side_of_a_body_that_sinks(rng: np.random.Generator) -> None:
    """Sunk by h straight down, the line stays; carried along it would be h lower: lever h makes up the difference."""
    shot: Photo = photo(plate(), rng)
    lines, _ = sightlines(part(), [shot], Rigid())
    feet = Feet.of(lines, edge_surroundings([shot], [ShownFaces.of(part(), shot, Rigid())], lines))
    rows = feet.mate >= 0
    h = 1e-3
    carried = seen_at(lines.p[rows] - [0.0, 0.0, h]) - seen_at(lines.p[rows])
    along_normal = np.einsum("ni,ni->n", carried, lines.normal[rows])
    # the picture is linear to (h / distance)^2, and the lever's normals come from a float32 rendering
    np.testing.assert_allclose(along_normal + feet.lever[rows] * h, 0.0, atol=1e-5 * h + 2e-7)
