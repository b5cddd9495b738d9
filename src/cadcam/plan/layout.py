"""The layout of a scene: which cameras to take, what they will measure, and why these."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from cadcam.arrays import Array, Brief, Mask
from cadcam.errors import BadValue, UnknownName, UnseenFeatures, listed
from cadcam.geometry.rigid import Rigid
from cadcam.kinds import expect, expect_callable, expect_count, expect_each, expect_names
from cadcam.plan.assessment.asked import Asked, asked_of
from cadcam.plan.assessment.assess import Assessment, Outcome, assess, informations
from cadcam.plan.choice.problem import MEASURED, Score, SelectionProblem, score_of
from cadcam.plan.choice.search import BestSet, best_set, one_fewer, one_more, ranked
from cadcam.plan.scene.layout_scene import LayoutScene
from cadcam.plan.sight.candidate import Candidate, candidates, share_errors
from cadcam.plan.sight.datum import Judging
from cadcam.plan.sight.places import Places
from cadcam.plan.sight.surroundings import Surroundings
from cadcam.plan.sight.visibility import Visibility, Why, seen_from

Step = Callable[[], None]


def nothing() -> None:
    """Do nothing: the default progress step."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class CandidateSurvey(Brief):
    """All candidates of a scene with what each sees: computed once, queried many times.

    left_out: candidates of zones that would stand inside of something, with what that is.
    """

    scene: LayoutScene
    candidates: tuple[Candidate, ...]
    visibility: tuple[Visibility, ...]
    places: Places
    asked: Asked
    surroundings: Surroundings
    judging: Judging | None
    problem: SelectionProblem
    left_out: tuple[tuple[str, str], ...] = ()

    @property
    def poses(self) -> tuple[Rigid, ...]:
        """Return world_from_part of all poses."""
        return tuple(self.scene.poses.values())

    def kept(self, names: Sequence[str] = ()) -> tuple[int, ...]:
        """Return the indices of the candidates that are fixed and of those named. Raises `UnknownName`."""
        every = [c.name for c in self.candidates]
        for name in names:
            if name not in every:
                raise UnknownName("candidate", name, every)
        return tuple(i for i, c in enumerate(self.candidates) if c.fixed or c.name in names)

    def assess(self, chosen: Sequence[int]) -> Assessment:
        """Return what some candidates measure together."""
        return assess(
            [self.candidates[i] for i in chosen],
            [self.visibility[i] for i in chosen],
            self.places,
            self.poses,
            self.asked,
        )

    def ratios(self, chosen: Sequence[int]) -> Array:
        """Return the ratios limit/U (P, L) of some candidates as `assess` states them: shared errors are shared."""
        if self.judging is not None or share_errors(self.candidates[i] for i in chosen):
            return self.assess(chosen).ratio
        return self.problem.ratios(chosen).reshape(len(self.poses), -1)  # the same, at a fraction of the cost

    def score(self, chosen: Sequence[int]) -> Score:
        """Return how good some candidates are, by these ratios."""
        return score_of(self.ratios(chosen).ravel())


@dataclass(frozen=True, slots=True)
class Role:
    """What a chosen camera contributes: how many features it sees in all poses, and what is lost without it.

    without: the score of the set without it; only_it: limits that are measured in all poses only because of it.
    """

    sees: int
    without: Score
    only_it: int


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Layout(Brief):
    """The chosen cameras of a scene, what they measure, and how they were found.

    chosen: indices of candidates, the fixed ones first. all_of_them: the score with every candidate at once, an upper
    bound of any choice where no errors are shared: as in the search, each errs by itself. growth: the score by number
    of cameras, around the number chosen; there, and in `roles`, shared errors are shared.
    """

    survey: CandidateSurvey
    chosen: tuple[int, ...]
    assessment: Assessment
    found: BestSet
    roles: tuple[Role, ...]
    all_of_them: Score
    growth: tuple[tuple[int, Score], ...] = field(default=())

    @property
    def cameras(self) -> tuple[Candidate, ...]:
        """Return the chosen cameras."""
        return tuple(self.survey.candidates[i] for i in self.chosen)

    @property
    def visibility(self) -> tuple[Visibility, ...]:
        """Return what each of them sees."""
        return tuple(self.survey.visibility[i] for i in self.chosen)

    @property
    def outcomes(self) -> list[Outcome]:
        """Return what can be said of each limit, in its worst pose."""
        return self.assessment.outcomes(self.survey.scene.tur)

    @property
    def outcome(self) -> Outcome:
        """Return the worst of all outcomes."""
        return max(self.outcomes, key=lambda o: o.rank)


def survey(scene: LayoutScene, *, step: Step = nothing) -> CandidateSurvey:
    """Return what every candidate of a scene sees; step is called after each.

    Raises `BadValue` for a camera inside of the part or an obstacle, `UnseenFeatures` for features that none sees.
    """
    around, judging = Surroundings(scene.part, scene.obstacles), Judging.of(scene)
    chosen, left_out = _outside(candidates(scene), around, scene)
    places = Places.of(scene.features)
    poses = tuple(scene.poses.values())
    visibility = []
    for candidate in chosen:
        visibility.append(
            seen_from(
                candidate.viewpoint,
                candidate.optics,
                places,
                poses,
                around,
                finder=scene.finder,
                seeing=scene.seeing,
                judging=judging,
            )
        )
        step()
    _refuse_unseen(scene, visibility)
    asked = asked_of(scene.features, _plane_sigmas(scene), scene.judged)
    cameras = scene.choose + sum(c.fixed for c in chosen)
    return CandidateSurvey(
        scene,
        chosen,
        tuple(visibility),
        places,
        asked,
        around,
        judging,
        SelectionProblem(informations(visibility, asked, cameras=cameras), asked),
        left_out,
    )


def plan_layout(
    scene: LayoutScene | CandidateSurvey, k: int | None = None, *, keep: Sequence[str] = (), step: Step | None = None
) -> Layout:
    """Return the best k cameras (default: the scene's number) beside the fixed ones, and what they measure.

    keep: names of candidates that are treated as fixed. The criterion is the worst limit's test uncertainty ratio
    over all poses. The search treats each camera's errors as its own; the statement about the chosen set accounts for
    shared ones, and so, beside a datum, do exchanges of single cameras after the search. Raises as `survey`.
    """
    expect(scene, "scene", LayoutScene, CandidateSurvey)
    expect(k, "number of cameras", int, np.integer, optional=True)
    keep = expect_names(keep, "keep")
    expect_callable(step, "step", optional=True)
    step = step or nothing
    seen = survey(scene, step=step) if isinstance(scene, LayoutScene) else scene
    fixed, problem = seen.kept(keep), seen.problem
    k = min(seen.scene.choose, problem.candidates - len(fixed)) if k is None else k
    if k == 0 and not fixed:
        raise BadValue("number of cameras", 0, "at least 1, where none is fixed")
    found = best_set(problem, k, fixed=fixed, step=step)
    if seen.judging is not None:
        found = _exchanged(seen, found, fixed, step)
    chosen = (*fixed, *found.chosen)
    growth = {len(chosen): seen.score(chosen)}
    if len(chosen) > 2 and found.chosen:
        growth[len(chosen) - 1] = seen.score((*fixed, *one_fewer(problem, found.chosen, fixed=fixed)))
    if len(chosen) < problem.candidates:
        growth[len(chosen) + 1] = seen.score((*fixed, *one_more(problem, found.chosen, fixed=fixed)))
    step()
    every = range(problem.candidates)
    return Layout(
        seen,
        chosen,
        seen.assess(chosen),
        found,
        tuple(_role(seen, chosen, i) for i in chosen),
        problem.score(every) if seen.judging is None else seen.score(every),
        tuple(sorted(growth.items())),
    )


def _exchanged(seen: CandidateSurvey, found: BestSet, fixed: Sequence[int], step: Step) -> BestSet:
    """Return a set after exchanges of one camera, as long as what is then stated of the set improves.

    The search takes the datum's error for each camera's own: its best set may be worse by half.
    """
    chosen, best, exchanges = found.chosen, seen.score((*fixed, *found.chosen)), 0
    while True:
        step()
        rest = [j for j in range(len(seen.candidates)) if j not in (*fixed, *chosen)]
        sets = [(*chosen[:i], j, *chosen[i + 1 :]) for i in range(len(chosen)) for j in rest]
        scores = [seen.score((*fixed, *s)) for s in sets]
        at = max(range(len(sets)), key=lambda i: scores[i].value, default=None)
        if at is None or not scores[at].beats(best):
            break
        chosen, best, exchanges = sets[at], scores[at], exchanges + 1
    return BestSet(tuple(sorted(chosen)), best, complete=not rest, sets=1, exchanges=found.exchanges + exchanges)


def next_cameras(seen: CandidateSurvey, have: Sequence[int]) -> list[tuple[Candidate, Score]]:
    """Return the other candidates with the score that each would bring when added to the cameras `have`, best first."""
    expect(seen, "seen", CandidateSurvey)
    have = expect_each(have, "have", int, np.integer)
    every = range(len(seen.candidates))
    for i, number in enumerate(have):
        expect_count(number, f"have[{i}]", least=0, most=len(every) - 1)
    if seen.judging is not None or share_errors(seen.candidates):
        scored = [(i, seen.score((*have, i))) for i in every if i not in set(have)]
        order = sorted(scored, key=lambda item: item[1].value, reverse=True)
    else:
        order = ranked(seen.problem, have, every)
    return [(seen.candidates[i], score) for i, score in order]


def _role(seen: CandidateSurvey, chosen: Sequence[int], i: int) -> Role:
    sees = seen.visibility[i].seen
    without = [c for c in chosen if c != i]
    measured, left = _measured(seen, chosen), _measured(seen, without)
    return Role(int(sees.all(axis=0).sum()), seen.score(without), int((measured & ~left).sum()))


def _measured(seen: CandidateSurvey, chosen: Sequence[int]) -> Mask:
    return np.asarray((seen.ratios(chosen) > MEASURED).all(axis=0))


def _outside(
    every: Sequence[Candidate], around: Surroundings, scene: LayoutScene
) -> tuple[tuple[Candidate, ...], tuple[tuple[str, str], ...]]:
    """Return the candidates that stand in free space, and those of zones that do not, with what they are inside of."""
    inside: dict[bytes, str] = {}
    kept, left_out = [], []
    for candidate in every:
        eye = candidate.eye
        key = np.round(eye, 6).tobytes()
        if key not in inside:
            inside[key] = around.holds(eye, dict(scene.poses))
        if not inside[key]:
            kept.append(candidate)
        elif candidate.spread:
            left_out.append((candidate.name, inside[key]))
        else:
            raise BadValue(
                f"position of camera {candidate.name!r}",
                f"{np.round(eye, 3).tolist()} mm, inside of {inside[key]}",
                "a place in free space; are part, pose and mount in the same world?",
            )
    if not kept:
        raise BadValue("candidates", f"{len(every)}, all inside of {left_out[0][1]}", "mounts in free space")
    return tuple(kept), tuple(left_out)


def _refuse_unseen(scene: LayoutScene, visibility: Sequence[Visibility]) -> None:
    """Raise `UnseenFeatures` for features that no candidate sees in any pose, with the reasons by their frequency."""
    seen = np.any([o.seen.any(axis=0) for o in visibility], axis=0)
    if seen.all():
        return
    lines = []
    for i in np.flatnonzero(~seen):
        codes = Counter(int(c) for o in visibility for c in o.why[:, i])
        total = sum(codes.values())
        said = ", ".join(f"{Why(c).words} {n / total:.0%}" for c, n in codes.most_common())
        lines.append(f"{scene.features[i].name!r} ({said})")
    names = tuple(scene.features[i].name for i in np.flatnonzero(~seen))
    raise UnseenFeatures(
        f"no candidate sees {len(lines)} of {len(seen)} features: {listed(lines, 5, by='; ')}; check places and "
        "normals, or add mounts",
        names,
    )


def _plane_sigmas(scene: LayoutScene) -> Array:
    """Return the sigma (F,) mm of each known plane's height: its own, combined with the part's placement."""
    middle = scene.part.bounds.mean(axis=0)
    out = np.full(len(scene.features), np.nan)
    for i, feature in enumerate(scene.features):
        if feature.plane_mm is not None and feature.normal is not None:
            lever = np.linalg.norm(np.cross(feature.p - middle, feature.normal))
            lies = scene.placement
            out[i] = np.sqrt(feature.plane_mm**2 + lies.position_mm**2 + (lies.rotation * lever) ** 2)
    return out
