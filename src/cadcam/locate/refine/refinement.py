"""The pose of a part to the limit of the pixels: visible CAD edges fitted to the photo's own.

Lines are drawn with hidden ones removed and pulled onto the photo's steps (`locate.lines.attraction`); the pose is
solved from the steps near them (`locate.refine.solution`) and believed only where the photo shows far more of the
part's edges than chance would (`locate.quality.support`). In doubt, lines are searched for again: farther away, beside
the pose, and guided by colour.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from cadcam.arrays import Array
from cadcam.errors import BadValue, DegenerateGeometry
from cadcam.geometry.rigid import Rigid, by_twist, expect_motion
from cadcam.kinds import expect, expect_each, expect_flag, expect_number
from cadcam.locate.evidence import Evidence, LineEvidence, PointEvidence, PoseEvidence
from cadcam.locate.freedom import FREE, Freedom
from cadcam.locate.lines.attraction import attracted
from cadcam.locate.lines.bands import LEFT
from cadcam.locate.lines.sight import Sight
from cadcam.locate.location import FOUND, Location
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.locate.quality.color import in_color
from cadcam.locate.quality.support import support_at
from cadcam.locate.refine.agreement import agreed
from cadcam.locate.refine.answer import DOUBT, PoseAnswer, location_of, lost, unseen_turns
from cadcam.locate.refine.consistency import Consistency
from cadcam.locate.refine.options import EDGES, EdgeOptions
from cadcam.locate.refine.released import released
from cadcam.locate.refine.retaken import at_their_sharpness
from cadcam.locate.refine.solution import CLOSE_PX, PoseSolution, solved

_PULLED_PX = 0.3  # error of lines that were pulled onto steps
_REDRAW_PX = 1.5  # motion of lines after which others may be visible
_WIDER, _WIDER_PX = 1.5, 14.0  # range of a wider search: times the first, and at least
_WEAKEST, _BESIDE_PX = 3, 4.0  # weakest motions along which a loose pose may be another one; motion of the lines tried
_ABOUT = 0.25  # share of the lines supported by colour from which a pose is approximately right
_AROUND_PX = (3.0, 5.0, 8.0)  # search ranges there
_EITHER = np.sqrt(0.5)  # share of the way to an equally likely answer, as a sd
_BANDED = 0.15  # share of a photo's lines beside bands from which these are modelled
_SAME_PX = 0.5  # a search that ends this near to its start, at a pose that was found, finds that one again
_ANY_TURN = np.pi**2 / 3  # rad^2: variance of an unknown rotation


def refine_pose(
    part: Part,
    photos: Sequence[Photo],
    start: Rigid,
    *,
    freedom: Freedom = FREE,
    evidence: Sequence[Evidence] = (),
    options: EdgeOptions = EDGES,
    chosen: int = 0,
    wider: bool = True,
) -> Location:
    """Return where the part is, from a start world_from_part whose lines are off by no more than `search_px`.

    photos: of one camera, of a rig, or of a moved camera, each with its viewpoint in the world. evidence: points, lines
    or poses of the part that are known by other means. chosen: how many constraints the start meets only because it was
    the best of many poses in these photos; these are no evidence (`locate.quality.support`). Less than 0: how many a
    fit is credited with whose start was foretold to some px, by motion or by texture. Where too little is seen to
    determine the pose, the answer has quality 0.

    wider: whether other poses are tried where the answer is in doubt (not useful where starts are known to be good, as
    farther off there are only other lines). These are: the result of a wider search from where the first one ended,
    because lines of a wrong pose often half agree; where edges fit loosely, poses slightly beside, if the start was the
    best of many or the answer is still in doubt; where edges scatter, the pose that most of them agree on closely
    (`locate.refine.agreement`); and where colour supports a doubtful answer, which must then be approximately right,
    the result of a search near it. Whether photos agree, and allow the restriction, is asked in any case.
    """
    expect(options, "options", EdgeOptions)
    expect(part, "part", Part)
    photos = expect_each(photos, "photos", Photo)
    expect_motion(start, "start")
    expect(freedom, "freedom", Freedom)
    evidence = expect_each(evidence, "evidence", PointEvidence, LineEvidence, PoseEvidence)
    expect_number(chosen, "chosen")
    if not float(chosen).is_integer():
        raise BadValue("chosen", chosen, "a whole number of constraints")
    expect_flag(wider, "wider")

    def found_in(photos: Sequence[Photo], times: Sequence[int]) -> list[Location]:
        told = evidence if max(times, default=1) == 1 else [one.reduced(times[one.photo]) for one in evidence]
        return [Refinement(part, photos, freedom, told, options, chosen, wider).around(start)[0]]

    return (at_their_sharpness(photos, found_in) if wider else found_in(photos, [1] * len(photos)))[0]


@dataclass(frozen=True, slots=True, eq=False)
class Refinement:
    """The arguments of `refine_pose` except for the start, and the steps by which it reaches an answer.

    least: quality that the lines must have once they are pulled onto the photos' steps, approximately that after the
    fit; else nothing is fitted. others: poses (world_from_part) of other instances of the part, which may hide its
    lines.
    """

    part: Part
    photos: Sequence[Photo]
    freedom: Freedom = FREE
    evidence: Sequence[Evidence] = ()
    options: EdgeOptions = EDGES
    chosen: int = 0
    wider: bool = True
    least: float = 0.0
    others: Sequence[Rigid] = ()

    def around(self, start: Rigid) -> tuple[Location, Sequence[Sight]]:
        """Return the answer of `refine_pose`, and the photos with the part's lines drawn near it."""
        if not self.photos:
            raise BadValue("photos", "none", "at least one photo")
        unseen = unseen_turns(self.part, self.freedom, start)
        told = self.freedom.without(unseen, start)
        asked = replace(self, freedom=told)
        best = asked.from_start(start)
        if self.wider:
            best = asked.in_color(asked.again(best), start)
        location = released(self.part, asked.consistent(best), self.freedom, self.options)
        return _turned_anyhow(location, unseen, start) if unseen.shape[1] else location, best.sights

    def from_start(self, start: Rigid) -> PoseAnswer:
        """Return the answer around a start."""
        sights, pose = self.attracted(self.sights(start), start, self.options.search_px)
        constraints = self.freedom.at(pose).shape[1] + self.chosen
        if (
            self.least > 0
            and support_at(sights, pose, constraints=constraints, scatter=_PULLED_PX).quality < self.least
        ):
            return PoseAnswer(lost(sights, pose, self.freedom, "too few of its lines are near the start"), None, sights)
        return self.settled(sights, pose)

    def again(self, best: PoseAnswer) -> PoseAnswer:
        """Return a doubtful or loose answer, or a better one found by a wider search, or slightly beside it."""
        quality = best.location.quality
        in_doubt = quality < DOUBT[1] or best.loose
        if quality <= DOUBT[0] or not (in_doubt or best.scattered):
            return best
        if in_doubt:
            best = self.farther(best)
        return self.beside(best) if self.chosen or best.location.quality < DOUBT[1] or best.scattered else best

    def farther(self, best: PoseAnswer) -> PoseAnswer:
        """Return the answer, or a better one from lines searched for farther away."""
        wide_px = max(_WIDER * self.options.search_px, _WIDER_PX)
        sights, pose = self.attracted(best.sights, best.pose, wide_px)
        if best.location.found and max(s.moved_px(best.pose, pose) for s in sights) < _SAME_PX:
            return best
        second = self.settled(sights, pose)
        return second if second.better_than(best) else best

    def beside(self, best: PoseAnswer) -> PoseAnswer:
        """Return a loose answer, or the first better and closer fit at a pose slightly beside it."""
        if best.solution is None or not (best.loose or best.scattered):
            return best
        for start in _beside(best.solution):
            sights, pose = self.attracted(best.sights, start, CLOSE_PX)
            if max(s.moved_px(best.pose, pose) for s in best.sights) < _SAME_PX:
                continue
            second = self.measured(sights, pose)
            if second.loose:
                continue
            second = self.redrawn(second)
            if not second.loose and second.better_than(best):
                return second
        return best

    def in_color(self, best: PoseAnswer, start: Rigid) -> PoseAnswer:
        """Return a doubtful answer, or a better one found where colour supports it or the start."""
        if all(photo.chroma is None for photo in self.photos):
            return best
        for search_px in _AROUND_PX:
            if best.location.quality >= DOUBT[1]:
                break
            share, pose, sights = max((self.colored(pose) for pose in (best.pose, start)), key=lambda s: s[0])
            if share < _ABOUT:
                break
            second = self.measured(*self.attracted(sights, pose, search_px))
            if second.location.quality > best.location.quality:
                best = second
        return best

    def consistent(self, best: PoseAnswer) -> PoseAnswer:
        """Return an answer from those photos that agree, and as uncertain as their disagreement makes it.

        One that would not be found is asked, too, unless hardly anything is shown: of two photos that contradict each
        other each shows all of the part, but together they show half of it.
        """
        if len(self.photos) < 2 or best.solution is None or best.location.quality < DOUBT[0]:
            return best
        consistency = Consistency.of(best.solution, self.options)
        by_fewer = self.by_fewer(best, consistency)
        return by_fewer or replace(best, location=consistency.stated_in(best.location, self.part, self.photos))

    def by_fewer(self, best: PoseAnswer, consistency: Consistency) -> PoseAnswer | None:
        """Return the answer without photos that show nothing of the part, or without the one that is inconsistent.

        None where all photos count, or where it is not clear which of them to leave out. One in which nothing of the
        part shows speaks against the pose: its quality remains that of all photos together, unless the start was
        foretold. One that shows the part elsewhere does not, where two others or more agree.
        """
        if self.evidence:  # it names photos by number: it would have to be renumbered
            return None
        blind = bool(consistency.blind and consistency.photos)
        if blind:
            candidates, why = [consistency.blind], "nothing of the part shows there"
        elif not consistency.holds and len(self.photos) > 2:
            candidates = [[one.photo] for one in consistency.photos]
            why = "the others agree, but not with it; does that camera stand where its file says?"
        else:
            return None
        tried = [(numbers, self.without(best, numbers)) for numbers in candidates]
        agreeing = [(numbers, *answer) for numbers, answer in tried if answer is not None]
        # Without a right photo, others that are off by little may agree, too, but not as closely as right ones do.
        agreeing = [one for one in agreeing if one[2]] or agreeing
        if len(agreeing) != 1:
            return None
        left_out, answer, _ = agreeing[0]
        location = answer.location
        of = consistency.disagreements(left_out, self.photos, left_out=True)
        told = location.noting(f"{', '.join(repr(one.name) for one in of)} left out: {why}")
        told = replace(told, disagreements=of)
        if not blind or self.chosen < 0 or best.location.quality >= location.quality:
            return replace(answer, location=told)
        if best.location.quality < FOUND:
            where = ", ".join(repr(one.name) for one in of)
            told = told.uncertain(f"nothing of the part shows in {where}: is it hidden, or that camera elsewhere?")
        return replace(answer, location=replace(told, quality=best.location.quality))

    def without(self, best: PoseAnswer, left_out: Sequence[int]) -> tuple[PoseAnswer, bool] | None:
        """Return the answer without some photos, and whether noise alone explains what is between the others.

        None where it is not found, or the others are not consistent either.
        """
        kept = [k for k in range(len(self.photos)) if k not in left_out]
        fewer = replace(self, photos=[self.photos[k] for k in kept])
        answer = fewer.settled(*fewer.attracted([best.sights[k] for k in kept], best.pose, self.options.search_px))
        if answer.solution is None or not answer.location.found:
            return None
        consistency = Consistency.of(answer.solution, self.options)
        if not consistency.holds:
            return None
        location = consistency.stated_in(answer.location, self.part, fewer.photos)
        return replace(answer, location=location.numbered(kept)), consistency.close

    def colored(self, pose: Rigid) -> tuple[float, Rigid, Sequence[Sight]]:
        """Return the share of the lines' samples that colour supports at a pose, the pose, and its sights."""
        sights = self.sights(pose)
        return in_color(self.part, sights, pose)[1], pose, sights

    def settled(self, sights: Sequence[Sight], pose: Rigid) -> PoseAnswer:
        """Return the answer at a pose with its lines drawn from there, or at the pose that most edges agree on."""
        answer = self.redrawn(self.measured(sights, pose))
        for closer in agreed(answer.solution) if self.wider and answer.solution is not None else ():
            other = self.measured(self.sights(closer, answer.sights), closer)
            answer = other if other.better_than(answer) else answer
        return answer

    def redrawn(self, answer: PoseAnswer) -> PoseAnswer:
        """Return the answer, with lines drawn again if its pose is so far off that other lines may be visible."""
        if answer.solution is None or not _away(answer.sights, answer.solution.pose):
            return answer
        pose = answer.solution.pose
        return self.measured(self.sights(pose, answer.sights), pose)

    def measured(self, sights: Sequence[Sight], pose: Rigid) -> PoseAnswer:
        """Return the answer measured near a pose.

        Bands beside the lines are modelled only if edges then agree more closely, and closely if the part is not found
        without them: with one more step at every line anything fits, if loosely. They are not modelled where starts are
        known to be good, nor for the many poses of a search that show nothing. The difference between the poses with
        and without bands counts as an error in either case.
        """
        try:
            fitted = solved(sights, pose, self.freedom, self.evidence, self.options)
        except DegenerateGeometry as error:
            return PoseAnswer(lost(sights, pose, self.freedom, str(error)), None, sights)
        plain = self.answered(fitted)
        hopeless = self.chosen != 0 and not plain.location.found
        if not self.wider or hopeless or fitted.beside_bands < _BANDED:
            return plain
        return self.beside_bands(sights, pose, fitted, plain.location.found)

    def beside_bands(self, sights: Sequence[Sight], pose: Rigid, untold: PoseSolution, found: bool) -> PoseAnswer:
        """Return the answer that models the bands, or else the one that does not; found: whether the latter was.

        If there are enough lines, all of them may be off at first (`locate.refine.regression`). If they then fit
        loosely, that leaves the pose to a few of them, and the answer that trusts them may be better.
        """
        best, unlike = None, None
        for lines in (True, False) if untold.tells_lines else (False,):
            try:
                told = solved(sights, pose, self.freedom, self.evidence, self.options, bands=True, lines=lines)
                answer = self.answered(told if lines else told.beside_its_bands())
            except DegenerateGeometry:
                continue
            unlike = unlike or told
            closer = told.fit.between < untold.fit.between and (found or not answer.loose)
            if answer.location.found and closer and (best is None or answer.better_than(best)):
                best = answer.unlike(self.part, untold, LEFT)
            if not answer.loose:
                break
        if best is not None:
            return best
        try:
            plain = self.answered(untold.beside_its_bands())
        except DegenerateGeometry as error:  # if bands may draw each line, the pose is undetermined
            return PoseAnswer(lost(sights, pose, self.freedom, str(error)), None, sights)
        return plain if unlike is None else plain.unlike(self.part, unlike, _EITHER)

    def answered(self, solution: PoseSolution) -> PoseAnswer:
        """Return the answer that a solution gives."""
        location = location_of(self.part, solution, self.freedom, chosen=self.chosen, wider=self.wider)
        return PoseAnswer(location, solution, solution.sights)

    def attracted(self, sights: Sequence[Sight], start: Rigid, search_px: float) -> tuple[Sequence[Sight], Rigid]:
        """Return the pose whose lines lie on steps of the photos near those at the start, and its sights."""
        pose = attracted(sights, start, self.freedom, search_px=search_px)
        return self.sights(pose, sights) if _away(sights, pose) else sights, pose

    def sights(self, pose: Rigid, before: Sequence[Sight] = ()) -> list[Sight]:
        """Return the lines drawn at a pose; the photos' noise known from `before` is kept."""
        seen = drawn(self.part, self.photos, pose, self.options, noise=[s.noise for s in before])
        return [sight.unoccluded(self.part, self.others) for sight in seen]


def drawn(
    part: Part, photos: Sequence[Photo], pose: Rigid, options: EdgeOptions, *, noise: Sequence[float] = ()
) -> list[Sight]:
    """Return the photos with a part's lines drawn at a pose; noise: of each photo, by default it is measured."""
    sizes = {"step_px": options.step_px, "reach_px": 2 * options.reach_px}
    each = zip(photos, noise or [np.nan] * len(photos), strict=True)
    return [Sight.of(part, photo, pose, noise=n, **sizes) for photo, n in each]


def _away(sights: Sequence[Sight], pose: Rigid) -> bool:
    """Return whether a pose is so far from where lines were drawn that others may be visible."""
    return max(s.moved_px(s.drawn, pose) for s in sights) > _REDRAW_PX


def _beside(fitted: PoseSolution) -> list[Rigid]:
    """Return poses beside that of a loose fit, along those motions of the lines that the photos determine least.

    Lines of thin plates seen edge-on may be mistaken for each other, all in the same sense: that is a fit too, if a
    loose one. It is a local minimum of its own: no search leads from it to the right pose.
    """
    moved = []
    for sight in fitted.sights:
        camera_from_part = sight.photo.camera_from_world @ fitted.pose
        q, J = sight.photo.camera.project_with_jacobian(camera_from_part @ sight.samples.p)
        moves = by_twist(sight.samples.p[:, None], J @ camera_from_part.rotation)
        moved.append(moves[np.isfinite(q).all(axis=1)])
    every = np.concatenate(moved) @ fitted.B
    r = np.linalg.qr(every.reshape(-1, every.shape[2]) / np.sqrt(len(every)))[1]  # |r x|: px, root mean square
    axes = np.linalg.eigh(r @ fitted.fit.covariance @ r.T)[1][:, -_WEAKEST:]
    steps = fitted.B @ np.linalg.solve(r, _BESIDE_PX * axes)
    return [fitted.pose @ Rigid.exp(sign * step) for step in steps.T for sign in (1, -1)]


def _turned_anyhow(location: Location, unseen: Array, start: Rigid) -> Location:
    """Return the answer for a part some of whose rotations, twists (6, k), no photo shows.

    Where nothing else was free, the part stays as in the start: what was fitted are the facets of a round body.
    """
    pose = location.pose
    at = unseen @ np.linalg.inv(np.linalg.qr(unseen[3:])[1])
    known = replace(pose, undetermined=at).determined
    told = replace(
        known,
        world_from_part=pose.world_from_part if known.freedom.shape[1] else start,
        from_noise=known.from_noise + _ANY_TURN * at @ at.T,
        freedom=np.linalg.qr(np.column_stack([known.freedom, unseen]))[0],
        undetermined=at,
    )
    how = "turned about its axis" if unseen.shape[1] == 1 else "however it is turned"
    said = f"not determined: {told.undetermined_words} ({how} the part looks the same)"
    return replace(location, pose=told).noting(said)
