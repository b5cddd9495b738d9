"""Why a limit failed or could not be decided, and what would decide it, in words for whoever stands by the part."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from cadcam.arrays import significant
from cadcam.errors import listed
from cadcam.image.faults import faults_of
from cadcam.locate.freedom import Freedom
from cadcam.locate.location import Location
from cadcam.locate.photo import Photo
from cadcam.locate.reason import Refusal
from cadcam.verify.adjustment.datum_fit import CAUSE_WORDS
from cadcam.verify.deviations.deviation import FeatureDeviation, State, Unclear
from cadcam.verify.tolerances.tolerance import SIGNED, Limit, Quantity, Rule
from cadcam.verify.tolerances.verdict import SIMPLE_SHARE, Judgement, Verdict

ANOTHER_VIEW, IN_VIEW = "take another view", "take a photo that shows it"
_NAMED = 3  # most features named in the summary
_SEVERAL, _GOOD_PART = 2, 1 / 3  # features unseen, of those asked, from which the part may be of another revision
_AXIS = 1e-9  # largest deviation of a direction from an axis by rounding
_BUT = ", but "  # in a reason, before what keeps a value from being decided apart from its U
_NO_DEPTH = "; how far parts are off along the line of sight one photo does not show"
_SURELY = "measure it more surely: "
_LESS_OF = {
    "noise": "more light, or go closer",
    "edges": "go closer, or take another view",
    "pose": "take more of the part into the picture",
    "calibration": "calibrate the camera better",
}
_FINE, _FINER = 0.1, 0.01  # limits below which three and four decimals are written
_MOST_DECIMALS = 6
LIMIT_DIGITS = 6  # of a limit: as it was written, but for the rounding of radians


def explained(j: Judgement, shares: Mapping[str, float]) -> Judgement:
    """Return a judgement whose reason says how far from its limit a value is, and what to do if that is less than U.

    shares: of each cause (`datum_fit.CAUSES`) in the variance. What was not measured, or has a remedy, keeps both.
    """
    if not np.isfinite(j.sigma):
        return j
    if j.verdict is Verdict.FAIL:
        beyond, simple = abs(j.deviation) - j.limit.value, j.limit.rule is Rule.SIMPLE
        least = _size(j, beyond) if simple else f"{_size(j, beyond - j.U)} at least"
        return replace(j, reason=f"{j.reason}; beyond the limit by {least}")
    if j.verdict is not Verdict.UNDECIDED or j.remedy:
        return j
    most = max(shares, key=lambda cause: shares[cause]) if shares else ""
    said = f"; most of U is {CAUSE_WORDS[most]} ({shares[most]:.0%})" if most else ""
    return replace(j, reason=f"{j.reason}; {_too_near(j)}{said}", remedy=_SURELY + _LESS_OF.get(most, ANOTHER_VIEW))


def with_remedy(j: Judgement) -> Judgement:
    """Return a judgement; the reason of one that is undecided ends with what would decide it."""
    if j.verdict is not Verdict.UNDECIDED:
        return j
    remedy = j.remedy or ANOTHER_VIEW
    short = remedy.removeprefix(_SURELY)
    return replace(j, remedy=remedy, reason=j.reason if short in j.reason else f"{j.reason}: {short}")


def summary(verdict: Verdict, judgements: Sequence[Judgement], *, one_photo: bool = False) -> str:
    """Return in one line why the part has its verdict: what failed, by how much; or what could not be decided, and why.

    one_photo: whether all was judged by one photo, or by several from one place. At most three things are said, each of
    one feature or of up to three alike. Where none of the edges of several features is seen, it asks for the part's
    revision: what is not there gives the same picture as what is not lit.
    """
    if not judgements:
        return "no limits given: nothing was judged"
    if verdict is Verdict.PASS:
        kept = {1: "the limit is", 2: "both limits are"}.get(len(judgements), f"all {len(judgements)} limits are")
        anyway = any(j.limit.quantity is Quantity.POSITION and j.limit.basis is None for j in judgements)
        return f"{kept} kept, uncertainty included{_NO_DEPTH if one_photo and anyway else ''}"
    undecided = [j for j in judgements if j.verdict in (Verdict.UNDECIDED, Verdict.NOT_FOUND)]
    if verdict is Verdict.FAIL:
        missing = {j.feature for j in judgements if j.verdict is Verdict.FAIL and j.limit.quantity is Quantity.PRESENCE}
        said = [failed_words(j) for j in judgements if j.verdict is Verdict.FAIL]
        left = sum(j.feature not in missing for j in undecided)
        also = [f"{left} more limit{'s' * (left > 1)} cannot be decided"] if left else []
    else:
        said, also = _undecided(undecided), []
    more = [f"and {len(said) - _NAMED} more"] if len(said) > _NAMED else []
    other = ["is it another revision of the part?"] if _perhaps_another_part(judgements) else []
    return "; ".join([*said[:_NAMED], *more, *also, *other])


def unjudged(features: Sequence[FeatureDeviation]) -> str:
    """Return in one line what stands out of a part without limits: displaced, by how much +- 2 sigma, or missing.

    At most three features are named; "" where nothing stands out.
    """
    off = [f for f in features if f.state is State.DISPLACED]
    said = [f"{f.name} is {f.size:.2f} +- {2 * f.sigma:.2f} mm off its place" for f in off]
    said += [f"{f.name} is missing" for f in features if f.state is State.MISSING]
    more = [f"and {len(said) - _NAMED} more"] if len(said) > _NAMED else []
    return "; ".join([*said[:_NAMED], *more])


def contradicting(names: Sequence[str]) -> str:
    """Return in one line which features of the stated datum do not agree with the rest of it, and what to do."""
    them, stand = ("it", "stands") if len(names) == 1 else ("them", "stand")
    return f"the datum contradicts itself: {', '.join(names)} {stand} out; leave {them} out of the datum"


def not_found(located: Location, photos: Sequence[Photo], freedom: Freedom) -> str:
    """Return in one line why the part was not found, and the faults of the photos that may be to blame.

    freedom: the motions to which the search was restricted.
    """
    why = located.why.bare if located.why.refusal is Refusal.NOT_FOUND else located.reason
    faults = [f"{photo.viewpoint.name}: {fault}" for photo in photos for fault in faults_of(photo.gray)]
    ask = located.doubts(freedom)
    if located.why.off_plane:
        ask = "if it does: is that plane in the world of the camera's pose, and known as well as stated?"
    return f"the part was not found: {'; '.join([why, *(faults or [ask])])}"


def unmeasured(found: FeatureDeviation) -> tuple[Verdict, str, str] | None:
    """Return verdict, reason and remedy for whatever is asked of a feature that was not measured; None: it was."""
    unclear = (found.why.value, found.why.remedy) if found.why else ("its edges do not tell where it is", ANOTHER_VIEW)
    without = {
        State.MISSING: (Verdict.NOT_FOUND, "it is missing: nothing of it to measure", ""),
        State.OUT_OF_VIEW: (Verdict.UNDECIDED, "not in view", IN_VIEW),
        State.UNCLEAR: (Verdict.UNDECIDED, *unclear),
    }
    return without.get(found.state)


def failed_words(j: Judgement) -> str:
    """Return in words what is wrong with a feature that failed."""
    return f"{j.feature} is missing" if j.limit.quantity is Quantity.PRESENCE else _off(j)


def direction_words(v: Sequence[float] | np.typing.NDArray[np.float64]) -> str:
    """Return a direction in the part's axes: the axis' name if it is one, else its components."""
    d = np.asarray(v, np.float64)
    axis = int(np.argmax(np.abs(d)))
    if np.abs(d).sum() - abs(d[axis]) < _AXIS * abs(d[axis]):
        return f"{'-' if d[axis] < 0 else ''}{'xyz'[axis]}"
    return vector_words(d)


def diameter_words(growth: float, limit: Limit, radii: np.typing.NDArray[np.float64]) -> str:
    """Return the diameter measured, given its growth (mm), and those allowed; of several circles the largest's."""
    of = " of its largest circle" if radii[-1] - radii[0] > 1e-3 * radii[-1] else ""
    return length_words(2 * float(radii[-1]), growth, limit, of=of)


def length_words(nominal: float, deviation: float, limit: Limit, *, of: str = "") -> str:
    """Return the length measured, given the CAD's and the deviation from it (mm), and those allowed; of: what it is."""
    decimals = max(decimals_of(limit), 2)
    measured, low, high = (f"{nominal + x:.{decimals}f}".rstrip("0").rstrip(".") for x in (deviation, *limit.bounds))
    return f"{measured} mm measured{of}, {low} to {high} mm allowed"


def way_words(limit: Limit) -> str:
    """Return along or across what a position counts, after a space; "" where it is all that the photos show."""
    if limit.axis is not None:
        return f" across {direction_words(limit.axis)}"
    return "" if limit.direction is None else f" along {direction_words(limit.direction)}"


def vector_words(v: np.typing.NDArray[np.float64]) -> str:
    """Return the components of a vector with two decimals, rounding to zero without a sign."""
    return "(" + ", ".join(f"{0.0 if abs(x) < 5e-3 else x:.2f}" for x in v) + ")"


def decimals_of(limit: Limit) -> int:
    """Return with how many decimals deviations and U are written beside a limit, in the unit of its quantity."""
    value = limit.quantity.per_unit * limit.value
    return 4 if value < _FINER else 3 if value < _FINE else 2


def shown_decimals(decimals: int, U: float) -> int:
    """Return how many decimals, these or more, show that an uncertainty is not nothing."""
    while decimals < _MOST_DECIMALS and 0 < U < 0.5 * 10.0**-decimals:
        decimals += 1
    return decimals


def _perhaps_another_part(judgements: Sequence[Judgement]) -> bool:
    """Return whether of several features, a good part of those asked, none of the edges that should show is seen."""
    asked = {j.feature for j in judgements if not j.between}
    unseen = {j.feature for j in judgements if not j.between and j.remedy == Unclear.UNSEEN.remedy}
    return len(unseen) >= max(_SEVERAL, _GOOD_PART * len(asked))


def _undecided(judgements: Sequence[Judgement]) -> list[str]:
    """Return a line for each value too near to its limit, and for each reason for which others were not measured."""
    said: dict[tuple[str, str], list[str]] = {}  # by value or feature, and reason: quantities
    for j in judgements:
        key = (f"{j.feature}: ", j.reason)
        if np.isfinite(j.sigma):
            but = j.reason.partition(_BUT)[2].removesuffix(f": {j.remedy}")
            key = (_off(j) + (f"{_BUT}{but}" if but else ""), j.remedy.removeprefix(_SURELY))
        said.setdefault(key, []).append(j.limit.quantity.name.lower())
    alike: dict[tuple[str, str], list[str]] = {}  # by what is not decided, and reason: features
    for (what, why), quantities in said.items():
        measured = not what.endswith(": ")
        key = (what, why) if measured else (f": {' and '.join(quantities)} cannot be decided", f" ({why})")
        alike.setdefault(key, []).extend([] if measured else [what.removesuffix(": ")])
    return [
        f"{listed(names, _NAMED)}{what}{why}" if names else f"{what}: {why}" for (what, why), names in alike.items()
    ]


def _off(j: Judgement) -> str:
    """Return a measured feature with its deviation, U and limit."""
    each = [j.limit.quantity.per_unit * x for x in (j.limit.bounds if j.limit.middle else (j.limit.value,))]
    bounds = " to ".join(significant(x, LIMIT_DIGITS) for x in each)
    limit = f"limit{'s' * (len(each) - 1)} {bounds} {j.limit.quantity.unit}"
    off = j.deviation + j.limit.middle
    value = f"{_number(j, off)} +- {_size(j, j.U)}"
    if j.limit.quantity is Quantity.ANGLE:
        return f"{j.feature} is turned by {value}, {limit}"
    if j.limit.quantity in SIGNED:
        size, more = f"{_number(j, abs(off))} +- {_size(j, j.U)}", "larger" if off > 0 else "smaller"
        what = f"{j.feature}'s diameter" if j.limit.quantity is Quantity.DIAMETER else j.feature
        return f"{what} is {size} {more} than in the CAD, {limit}"
    what = "has a piece of edge" if j.limit.quantity is Quantity.PROFILE else "is"
    return f"{j.feature} {what} {value} off its place{way_words(j.limit)}, {limit}"


def _too_near(j: Judgement) -> str:
    """Return why a value is not decided by its U."""
    if j.limit.rule is Rule.SIMPLE:
        return f"U is more than {SIMPLE_SHARE:.0%} of the limit"
    if j.limit.value <= j.U:
        return "U is not below the limit, so not even a feature in place passes"
    gap = j.limit.value - abs(j.deviation)
    return f"{_size(j, abs(gap))} {'within' if gap >= 0 else 'beyond'} the limit, which is less than U"


def _size(j: Judgement, value: float) -> str:
    return f"{_number(j, value)} {j.limit.quantity.unit}"


def _number(j: Judgement, value: float) -> str:
    """Return a value of a judgement in the unit of its quantity, with the decimals that its limit asks for."""
    decimals = shown_decimals(decimals_of(j.limit), j.limit.quantity.per_unit * j.U)
    return f"{round(j.limit.quantity.per_unit * value, decimals) + 0.0:.{decimals}f}"
