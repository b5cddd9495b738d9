"""The parameters that a joint calibration needs: comparison of nested models, and a recommendation in words.

Each question is about one parameter or a few that belong together, free or held at the value of an ideal camera. Three
criteria: the F-test on the sums of squares, which takes every pixel for an independent measurement; a Wald test with
the covariance between views, which does not; and the error on views left out. Source of the F-test: Seber and Wild,
"Nonlinear Regression" (1989), section 5.3.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from cadcam.arrays import Array
from cadcam.calibrate.joint.adjustment import JointFit, fit_of
from cadcam.calibrate.joint.held_out import held_out_error
from cadcam.camera.extended_pinhole import INTERNALS
from cadcam.camera.lens import BrownConrady, Ideal
from cadcam.errors import CadcamError, TooFewPoints
from cadcam.fit.block_least_squares import minimise_blocks
from cadcam.fit.joint_model import BEND, JointModel, JointState
from cadcam.fit.levenberg_marquardt import Options
from cadcam.kinds import expect

_LEVEL = 0.01  # significance level
_WORSE = 1.01  # ratio of held-out errors that is not an improvement
_TANGENTIAL: tuple[str, ...] = ("p1", "p2")
_BROWN: tuple[tuple[str, ...], ...] = (("k1",), ("k2",), _TANGENTIAL, ("k3",), ("k4", "k5", "k6"))
_VIEWS = 4  # with fewer, the scatter between views is not used
_ROUNDING = 1e-9  # of the noise, or px: smaller residuals count as zero


@dataclass(frozen=True, slots=True)
class Question:
    """Whether the parameters `names` are needed, for a model that has them or not (`included`).

    values, sigmas: with them free. F, chance: of the F-test; chance_by_view: of the Wald test with the covariance
    between views, nan for too few. held_out_with, held_out_without: px, nan where views cannot be left out. residual_*:
    the thesis' residual in px.
    """

    names: tuple[str, ...]
    included: bool
    values: tuple[float, ...]
    sigmas: tuple[float, ...]
    F: float
    chance: float
    chance_by_view: float
    held_out_with: float
    held_out_without: float
    residual_with: float
    residual_without: float

    @property
    def needed(self) -> bool:
        """Return whether the parameters are significant, by views if there are enough, and do not harm others."""
        chance = self.chance if np.isnan(self.chance_by_view) else self.chance_by_view
        worse = self.held_out_with > _WORSE * self.held_out_without
        return bool(chance < _LEVEL and not worse)

    @property
    def verdict(self) -> str:
        """Return the advice and its reasons in one sentence."""
        what = " ".join(self.names)
        action = ("keep" if self.needed else "hold") if self.included else ("free" if self.needed else "leave")
        return f"{action} {what}: {self._grounds()}"

    def _grounds(self) -> str:
        by_view = not np.isnan(self.chance_by_view)
        chance = self.chance_by_view if by_view else self.chance
        how = "by the scatter between views" if by_view else "by the F-test (too few views for their scatter)"
        text = f"{'significant' if chance < _LEVEL else 'not significant'} {how}, {_chance(chance)}"
        if by_view and self.chance < _LEVEL <= chance:
            text += f" (the F-test alone, {_chance(self.chance)}, would have been deceived by errors that views share)"
        if np.isfinite(self.held_out_with) and np.isfinite(self.held_out_without):
            text += f"; error on left-out views {self.held_out_without:.4g} -> {self.held_out_with:.4g} px with it"
        return text + f"; residual {self.residual_without:.4g} -> {self.residual_with:.4g} px"


@dataclass(frozen=True, slots=True)
class Advice:
    """The questions about one calibration, and what to do."""

    questions: tuple[Question, ...]

    @property
    def recommendation(self) -> str:
        """Return what to change, the most important first, in words."""
        if not self.questions:
            return "none: the points leave no residual to compare models by; add points or views"
        free = [q for q in self.questions if not q.included and q.needed]
        hold = [q for q in self.questions if q.included and not q.needed]
        parts = []
        if free:
            best = max(free, key=lambda q: q.F)
            parts.append(f"set {' '.join(best.names)} free and ask again")
        if hold:
            names = " and ".join(" ".join(q.names) for q in hold)
            parts.append(f"hold {names}, which the views do not show")
        return "; ".join(parts) if parts else "the model fits the views: nothing to add, nothing to leave out"


def nested_advice(fit: JointFit) -> Advice:
    """Return the comparisons of nested models for a joint calibration without robust loss.

    Tested are aspect (1), skew (0), the principal point (the centre), bend, the last free lens coefficients and the
    next ones; for an ideal lens its first radial term. Models that the views do not determine are left out.
    """
    expect(fit, "fit", JointFit)
    fit = _with_lens(fit)
    error = _held_out(fit, 0.0)
    questions = [ask(fit, names, held_out=error) for names in _groups(fit)]
    return Advice(tuple(q for q in questions if q is not None))


def ask(fit: JointFit, names: tuple[str, ...], *, held_out: float = np.nan) -> Question | None:
    """Return the comparison of the model with and without these parameters, None where the views do not determine it.

    held_out: the fit's own held-out error, px; with nan left-out views are not compared.
    """
    included = set(names) <= set(fit.model.free)
    if set(names) & set(fit.model.free) and not included:
        return None
    try:
        if included:
            less = _fitted(fit, [n for n in fit.model.free if n not in names], _neutral(fit, names))
            return _compared(fit, less, names, included=True, held=(held_out, _held_out(less, held_out)))
        more = _fitted(fit, _in_order(fit.model, [*fit.model.free, *names]), fit.solution.state)
        return _compared(more, fit, names, included=False, held=(_held_out(more, held_out), held_out))
    except CadcamError:
        return None


def _groups(fit: JointFit) -> list[tuple[str, ...]]:
    """Return the groups of parameters to ask about.

    Of the lens: the last family of coefficients that is free, the next one that is not, and the tangential ones, of
    which nothing is asked before another is free.
    """
    groups: list[tuple[str, ...]] = [("aspect",), ("skew",), ("U0", "V0")]
    if fit.model.bump is not None:
        groups.append(BEND)
    of_lens = _BROWN if isinstance(fit.model.lens, BrownConrady) else [(n,) for n in fit.model.lens.parameters]
    families = [f for f in of_lens if f != ("a1",)]  # a1 is redundant with the focal length
    free = [f for f in families if set(f) & set(fit.model.free)]
    held = [f for f in families if f not in free]
    groups += [f for f in free if f != _TANGENTIAL][-1:]
    groups += [_TANGENTIAL] if _TANGENTIAL in free else []
    groups += [f for f in held if f != _TANGENTIAL][:1]
    return groups + ([_TANGENTIAL] if _TANGENTIAL in held and free else [])


def _compared(
    more: JointFit, less: JointFit, names: tuple[str, ...], *, included: bool, held: tuple[float, float]
) -> Question:
    from scipy.stats import f

    q, dof = len(names), more.solution.blocks.dof
    if dof < 1:
        raise TooFewPoints("a comparison of models", len(more.views), len(more.views) + 1, of="views")
    fine, coarse = more.solution.blocks.sum_of_squares, less.solution.blocks.sum_of_squares
    F = max(coarse - fine, 0.0) / q / max(fine / dof, _ROUNDING**2)
    place = [more.model.free.index(n) for n in names]
    values = _shared_values(more.model, more.solution.state)[place]
    sigmas = np.sqrt(more.variance * np.diag(more.known.shared)[place])
    residuals = [float(np.sqrt(np.nanmean(np.sum(m.model.residuals(m.solution.state) ** 2, -1)))) for m in (more, less)]
    return Question(
        names=names,
        included=included,
        values=tuple(values.tolist()),
        sigmas=tuple(sigmas.tolist()),
        F=float(F),
        chance=float(f.sf(F, q, dof)),
        chance_by_view=_by_view(more, place, values - _neutral_values(less, names)),
        held_out_with=held[0],
        held_out_without=held[1],
        residual_with=residuals[0],
        residual_without=residuals[1],
    )


def _by_view(fit: JointFit, place: list[int], off: Array) -> float:
    from scipy.stats import f

    k, q = len(fit.views), len(place)
    if k < max(_VIEWS, q + 2):
        return float("nan")
    try:
        C = fit.known.jackknifed()[np.ix_(place, place)]
    except CadcamError:
        return float("nan")
    return float(f.sf(off @ np.linalg.solve(C, off) / q, q, k - 1))


def _fitted(fit: JointFit, free: Sequence[str], state: JointState) -> JointFit:
    model = fit.model.with_free(free)
    solution = minimise_blocks(model, state, options=Options(settled=1e-12, enough=1e-19))
    return fit_of(model, solution, fit.views, fit.size, fit.origin)


def _neutral_values(fit: JointFit, names: tuple[str, ...]) -> Array:
    values = fit.model.values(fit.solution.state)
    return np.array([values[n] for n in names])


def _neutral(fit: JointFit, names: tuple[str, ...]) -> JointState:
    """Return the state with these parameters at an ideal camera's values."""
    width, height = fit.size
    plain = {"aspect": 1.0, "U0": (height - 1) / 2, "V0": (width - 1) / 2}
    state = fit.solution.state
    internals, lens, bend = state.internals.copy(), state.lens.copy(), state.bend.copy()
    coefficients = tuple(fit.model.lens.parameters)
    for name in names:
        if name in INTERNALS:
            internals[INTERNALS.index(name)] = plain.get(name, 0.0)
        elif name in BEND:
            bend[BEND.index(name)] = 0.0
        else:
            lens[coefficients.index(name)] = 0.0
    return replace(state, internals=internals, lens=lens, bend=bend)


def _with_lens(fit: JointFit) -> JointFit:
    """Return the same fit with a lens that has terms to test."""
    if not isinstance(fit.model.lens, Ideal):
        return fit
    lens = BrownConrady()
    state = replace(fit.solution.state, lens=np.zeros(len(lens.parameters)))
    return replace(fit, model=replace(fit.model, lens=lens), solution=replace(fit.solution, state=state))


def _in_order(model: JointModel, names: Sequence[str]) -> list[str]:
    return [n for n in (*INTERNALS, *model.lens.parameters, *BEND) if n in names]


def _held_out(fit: JointFit, other: float) -> float:
    """Return the error on left-out views; nan where there is none, or none of the other model to compare it with."""
    if np.isnan(other):
        return np.nan
    try:
        return held_out_error(fit)
    except TooFewPoints:
        return float("nan")


def _chance(p: float) -> str:
    return f"p = {p:.2g}" if p >= 1e-12 else "p < 1e-12"


def _shared_values(model: JointModel, state: JointState) -> Array:
    """Return the values (n,) of the model's free parameters."""
    values = model.values(state)
    return np.array([values[name] for name in model.free])
