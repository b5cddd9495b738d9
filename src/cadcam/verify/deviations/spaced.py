"""The distance between two features as the photos show it: both displacements at once, against one pose."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cadcam.arrays import Array, Mask
from cadcam.verify.adjustment.datum_fit import Estimate
from cadcam.verify.adjustment.following import BodyLines
from cadcam.verify.deviations.measured import OPEN_PX, UNSEEN_PX, MeasuredEdges, with_bends
from cadcam.verify.tolerances.spacing import Spacing

_POSE_PX = 30.0  # sd, in px, of the part's place beside these edges: it has been found


def spaced(measured: MeasuredEdges, ends: tuple[Mask, Mask], spacing: Spacing) -> Estimate | None:
    """Return by how much (1,) mm places (n,) of one end are farther from those of the other than in the CAD.

    Each end may be displaced along its basis, its feet with it, and circles be of another size. What both have of the
    pose's errors cancels, so other edges need not hold the part. None: an end is not seen.
    """
    rows = ends[0] | ends[1]
    if not all(end.any() for end in ends):
        return None
    pose = measured.adjustment.pose(without=rows, within_px=_POSE_PX)
    bodies, open_mm = [measured.body_lines(end) for end in ends], OPEN_PX / UNSEEN_PX * measured.unseen_mm(rows)
    no_turns = np.zeros((3, 0))
    motions = [b.motions(basis * open_mm, no_turns, open_mm) for b, basis in zip(bodies, spacing.bases, strict=True)]
    design = _side_by_side(ends, bodies, motions)[rows]
    found = measured.adjustment.estimate(rows, design, pose, prior=1.0, enlarged=True, shared=True)
    each = np.split(found.value, [motions[0].shape[1]])
    straight = measured.adjustment
    for end, own, value in zip(ends, motions, each, strict=True):
        straight = measured.straightened(straight, end, own @ value)
    found, bent = (
        offsets.estimate(rows, design, pose, prior=1.0, enlarged=True, shared=True)
        for offsets in (straight, measured.bent(straight, rows))
    )
    found = with_bends(found, bent)
    ways = spacing.way[None] if spacing.across is None else np.stack([spacing.way, spacing.across])
    apart = found.along(np.column_stack([ways @ motions[0][:3], -ways @ motions[1][:3]]))
    return apart if spacing.across is None else _longer(apart, spacing.mm)


def _longer(apart: Estimate, mm: float) -> Estimate:
    """Return by how much (1,) mm a line of so many mm is longer whose ends are displaced along and across it."""
    line = np.array([mm, 0.0]) + apart.value
    length = float(np.linalg.norm(line))
    return replace(apart.along(line / length), value=np.array([length - mm]))


def _side_by_side(ends: tuple[Mask, Mask], bodies: list[BodyLines], motions: list[Array]) -> Array:
    """Return how far (n, m) px all places move by the motions of either end."""
    design = np.zeros((len(ends[0]), sum(own.shape[1] for own in motions)))
    columns = np.split(np.arange(design.shape[1]), [motions[0].shape[1]])
    for end, body, own, mine in zip(ends, bodies, motions, columns, strict=True):
        design[np.ix_(end, mine)] = body.moved_by(own, np.zeros(len(body.p), bool))
    return design
