"""Whether the photos confirm that a part's motion is restricted as stated: to a plane, an axis, a direction.

What is not free stays as in the start. If the start lies slightly beside the plane, or the stated axis slightly beside
the true one, the result is a pose that most lines agree with; only their scatter shows that it is off by far more than
its uncertainty, which assumes the restriction. So the part is released where it was found and fitted freely. If the
free pose differs from the restriction by more than its uncertainty, the covariance of the answer includes the
difference; where lines move by more than lens and chamfers may be off, it is asked whether the restriction holds.
"""

from __future__ import annotations

import numpy as np

from cadcam.errors import DegenerateGeometry
from cadcam.geometry.rigid import Rigid
from cadcam.locate.freedom import FREE, Freedom
from cadcam.locate.lines.attraction import attracted
from cadcam.locate.location import Location
from cadcam.locate.part import Part
from cadcam.locate.refine.answer import PoseAnswer, less_sure, location_of
from cadcam.locate.refine.options import EdgeOptions
from cadcam.locate.refine.solution import CLOSE_PX, LOOSE_PX, PoseSolution, solved

_UNLIKELY = 20.0  # squared sds of a difference from the restriction that counts: less than one in 800 by chance
_LEAST_PX = 0.2  # motion of the lines from which the restriction is doubted: less may be due to the lens, or a chamfer


def released(part: Part, best: PoseAnswer, freedom: Freedom, options: EdgeOptions) -> Location:
    """Return the location of a found answer under a restriction; it says so if the photos contradict that."""
    found = best.location
    if freedom.full or not found.found or best.solution is None:
        return found
    free = _free(part, best, options)
    if free is None or not _contradicted(best, free):
        return found
    there, B = free.pose.world_from_part, found.pose.freedom
    away = (best.pose.inv @ there).log()
    moved = B @ (B.T @ away)  # by the restriction, along the motions that are free
    middle, px = part.aspects.centre, max(s.moved_px(best.pose, there) for s in best.sights)
    mm = float(np.linalg.norm(best.pose @ middle - there @ middle))
    degrees = float(np.degrees(np.linalg.norm(away[3:])))
    said = f"free to move it would lie {mm:.2g} mm and {degrees:.2g} degrees off ({px:.1f} px)"
    asked = "does it stand as the start has it, and move as it is said to?"
    grown = less_sure(found, np.outer(moved, moved), middle, [s.photo for s in best.sights])
    if px > CLOSE_PX:
        return grown.uncertain(f"the photos contradict the restricted motion: {said}: {asked}")
    doubt = f": {asked}" * (px >= _LEAST_PX)
    return grown.noting(f"{said}{doubt}")


def _contradicted(best: PoseAnswer, free: Location) -> bool:
    """Return whether the free pose differs, as it hardly does by chance, in motions that the restriction forbids."""
    B, there = best.location.pose.freedom, free.pose.world_from_part
    N = np.linalg.svd(B)[0][:, B.shape[1] :]  # the motions that are not free
    beside = N.T @ (best.pose.inv @ there).log()
    return float(beside @ np.linalg.solve(N.T @ free.pose.covariance @ N, beside)) > _UNLIKELY


def _free(part: Part, best: PoseAnswer, options: EdgeOptions) -> Location | None:
    """Return where the part is if it may move freely; None where it is not found so, or no better."""
    try:
        solution = _solved(best, best.pose, options)
        if best.loose:
            wider = attracted(best.sights, best.pose, FREE, search_px=options.search_px)
            solution = min(solution, _solved(best, wider, options), key=lambda s: s.fit.between)
    except DegenerateGeometry:
        return None
    free = location_of(part, solution, FREE, chosen=0, wider=False)
    return free if free.found and solution.fit.between < LOOSE_PX else None


def _solved(best: PoseAnswer, pose: Rigid, options: EdgeOptions) -> PoseSolution:
    return solved(best.sights, pose, FREE, (), options)
