"""A verification in words and tables: for the terminal and the report."""

from __future__ import annotations

import numpy as np

from cadcam.arrays import significant
from cadcam.geometry.rotation import hat
from cadcam.report.table import Table, counted
from cadcam.verify.adjustment.datum_fit import CAUSE_WORDS
from cadcam.verify.deviations.deviation import FeatureDeviation, State
from cadcam.verify.inspection import Inspection
from cadcam.verify.judge import Verification
from cadcam.verify.reasons import LIMIT_DIGITS, contradicting, decimals_of, shown_decimals, vector_words
from cadcam.verify.tolerances.tolerance import Quantity, Rule
from cadcam.verify.tolerances.verdict import SIMPLE_SHARE, Judgement, Verdict


def verification_tables(found: Verification) -> list[Table]:
    """Return the judgements, and the outcome for each feature."""
    tables = [judgement_table(found)]
    if found.inspection is not None and found.inspection.found:
        tables.append(feature_table(found, found.inspection))
    return tables


def judgement_table(found: Verification) -> Table:
    """Return one line for each limit, the verdict in the title."""
    rows = []
    for j in found.judgements:
        deviation, U, limit = in_unit(j)
        rows.append((j.feature, j.limit.quantity.name.lower(), deviation, U, limit, j.verdict.value, j.reason))
    return Table(
        f"{found.verdict.value}: {found.reason}",
        ("feature", "what", "deviation", "U", "limit", "verdict", "why"),
        tuple(rows),
        ("feature", "what", "verdict", "why"),
        (rule_words(found),) if rows else (),
    )


def unclear_words(seen: Inspection) -> list[str]:
    """Return which features are unclear, and why: one line per reason."""
    why: dict[str, list[str]] = {}
    for f in seen.features:
        if f.state is State.UNCLEAR and f.why is not None:
            why.setdefault(f.why.value, []).append(f.name)
    return [f"unclear, {', '.join(names)}: {reason}" for reason, names in why.items()]


def to_do(found: Verification) -> list[tuple[str, list[str]]]:
    """Return the recommended actions for the verdict and the features concerned: what failed first."""
    out: dict[str, list[str]] = {}
    bodies = {f.name for f in found.tolerances.features if f.selection.whole}
    bodies |= {d.name for d in found.tolerances.distances if bodies & {*d.between}}
    for j in found.judgements:
        if j.verdict is Verdict.FAIL:
            out.setdefault(_wrong(j, mounted=j.feature in bodies), []).append(j.feature)
    for j in found.judgements:
        if j.verdict is Verdict.UNDECIDED and j.remedy:
            out.setdefault(f"{j.remedy[0].upper()}{j.remedy[1:]}", []).append(j.feature)
    return [(what, list(dict.fromkeys(names))) for what, names in out.items()]


def _wrong(j: Judgement, *, mounted: bool) -> str:
    """Return what to do about a limit that failed, of a body that can be moved or of what was made in one."""
    if j.limit.quantity is Quantity.PRESENCE:
        return "Mount what is missing"
    if j.limit.quantity is Quantity.ANGLE:
        return "Turn back, or have it decided whether it can stay"
    if j.limit.quantity is Quantity.DIAMETER:
        return "Make it to size, or have it decided whether it can stay"
    if not mounted:
        return "Have it decided whether it can stay where it was made"
    return "Put back into place, or have it decided whether it can stay"


def role(found: Verification, feature: FeatureDeviation) -> str:
    """Return the role of a feature in the verdict: judged by a limit, the pose's datum, or compared with the CAD.

    A judged one may be of a stated datum, too: it is measured from the others of it.
    """
    if any(feature.name in (j.feature, *j.between) for j in found.judgements):
        return "judged"
    return "datum" if feature.datum else "compared"


def feature_table(found: Verification, seen: Inspection) -> Table:
    """Return the outcome for each feature in view."""
    rows = []
    for f in seen.features:
        if f.state is State.OUT_OF_VIEW:
            continue
        moved = "" if f.displacement is None else vector_words(f.vector)
        size = "" if f.displacement is None else f"{f.size:.3f}"
        U = "" if f.displacement is None else f"+- {2 * f.sigma:.3f}"
        edges = f"{f.presence.seen}/{f.presence.expected}"
        rows.append((f.name, f.state.value, edges, size, U, moved, role(found, f)))
    return Table(
        "Features in view",
        ("feature", "state", "edges seen", "displaced mm", "2 sigma", "vector mm", "role"),
        tuple(rows),
        ("feature", "state", "vector mm", "role"),
        tuple(feature_notes(seen)),
    )


def feature_notes(seen: Inspection) -> list[str]:
    """Return the notes on the table of features, one line each."""
    notes = [
        "displacement against a pose fitted to the datum without the feature, +- 2 sigma, in the part's axes, as far "
        "as the photos show it"
    ]
    notes += [str(seen.covered)] if seen.covered else []
    if datum := [f.name for f in seen.features if f.state is State.DATUM]:
        what = "what the others are measured from, so that there is nothing else to compare it with"
        notes.append(f"datum, {', '.join(datum)}: {what}")
    notes += unclear_words(seen)
    if seen.left_out:
        notes.append(f"left out of the datum, for they do not agree with the rest: {', '.join(seen.left_out)}")
    if seen.contradictions:
        notes.append(f"{contradicting(seen.contradictions)}, or what is measured from it is off")
    if seen.extra:
        notes.append(
            f"{counted(len(seen.extra), 'curve')} inside the part that no edge of the model explains: shadows, "
            "rounded edges, dirt, or things that are not in the CAD"
        )
    return notes


def in_unit(j: Judgement) -> tuple[str, str, str]:
    """Return deviation, U and limit with their unit, as text: three decimals, more where the limit asks for them.

    Deviations are told from the CAD, and so are the bounds of a zone about another middle.
    """
    if j.limit.quantity is Quantity.PRESENCE:
        return "", "", "required"
    scale, unit = j.limit.quantity.per_unit, j.limit.quantity.unit
    limit = f"{significant(scale * j.limit.value, LIMIT_DIGITS)} {unit}"
    if j.limit.middle:
        low, high = (significant(bound, LIMIT_DIGITS) for bound in j.limit.bounds)
        limit = f"{low} to {high} {unit}"
    if not np.isfinite(j.deviation):
        return "", "", limit
    decimals = shown_decimals(max(decimals_of(j.limit), 3), scale * j.U)
    deviation = round(scale * (j.deviation + j.limit.middle), decimals) + 0.0
    return f"{deviation:+.{decimals}f} {unit}", f"{scale * j.U:.{decimals}f}", limit


def rule_words(found: Verification) -> str:
    """Return the decision rules used, one sentence."""
    rules = {j.limit.rule for j in found.judgements}
    words = []
    if Rule.GUARD_BAND in rules or not rules:
        words.append(
            "ISO 14253-1: with U = k sigma, PASS if |deviation| <= limit - U, FAIL if |deviation| > limit + U, else "
            "UNDECIDED"
        )
    if Rule.SIMPLE in rules:
        words.append(
            f"simple acceptance: the deviation alone is compared, where U is at most {SIMPLE_SHARE:.0%} of the limit"
        )
    return "; ".join(words)


def weakest_direction(seen: Inspection) -> tuple[str, float]:
    """Return the least certain motion of the part, in words, and its displacement of the part's middle (1 sigma), mm.

    The pose's covariance is transformed to the middle of what is seen, where translation and rotation are least
    correlated, and a rotation counts by its displacement of the edges there.
    """
    p = seen.survey.lines.p
    middle = p.mean(axis=0)
    radius = float(np.sqrt(np.mean(np.sum((p - middle) ** 2, axis=1))))
    to_middle = np.eye(6)
    to_middle[:3, 3:] = -hat(middle)
    T = np.diag([1.0] * 3 + [radius] * 3) @ to_middle
    w, V = np.linalg.eigh(T @ seen.pose.covariance @ T.T)
    v, sigma = V[:, -1], float(np.sqrt(max(w[-1], 0.0)))
    if np.linalg.norm(v[:3]) >= np.linalg.norm(v[3:]):
        return f"translation along {vector_words(v[:3] / np.linalg.norm(v[:3]))}", sigma
    return f"rotation about {vector_words(v[3:] / np.linalg.norm(v[3:]))}", sigma


def assumptions(found: Verification) -> list[str]:
    """Return the assumptions of the verdict, one sentence each."""
    seen = found.inspection
    if seen is None or not seen.found or seen.measured is None:
        return []
    out = [
        "Datum: the pose was fitted to " + ", ".join(seen.datum) + "; they are taken to be as the CAD has them.",
        "Each feature is rigid; its displacement is that of all its edges together, against a pose fitted without it.",
    ]
    if seen.measured.eye is not None:
        sight = vector_words(seen.measured.axis(np.ones(len(seen.measured.lines), bool)))
        out.append(
            f"One photo: a displacement along the line of sight (about {sight}, part axes) is not seen; all "
            "displacements are those across it."
        )
    if seen.sized_by_datum:
        out.append(
            "One photo shows a part that is larger as a whole, datum and all, as it shows one that is nearer: "
            "distances and diameters are right if the datum has its size in the CAD. A second camera, or a plane on "
            "which the part is known to lie, shows that."
        )
    if seen.survey.mate.max(initial=-1) >= 0:
        out.append(
            "A line where a feature stands on another moves with it as far as it is lifted or slides; where it sinks "
            "in, the line slides up its side. Both are considered."
        )
    out.append(
        f"Each edge errs as a whole by {seen.tau_px:.3f} px (1 sigma, a shift and a tilt; estimated from the datum's "
        f"edges), beside noise along it, {seen.noise_scale:.2f} times what the photo's own noise predicts."
    )
    if not seen.survey.lines.by_cause.shape[1]:
        out.append("The camera is taken to be known exactly: its file has no covariance, or the pose absorbs it.")
    out.append(
        f"Missing features: where nothing is, clutter makes an edge seem seen with probability {seen.clutter:.2f}, as "
        "counted at decoys in the same photos; surfaces are matt and lit from afar, but for shadows."
    )
    return out


def shares_in_words(f: FeatureDeviation) -> str:
    """Return the causes of a feature's uncertainty, the largest first."""
    shares = sorted(f.shares.items(), key=lambda item: -item[1])
    return ", ".join(f"{CAUSE_WORDS[cause]} {share:.0%}" for cause, share in shares if share >= 0.005)
