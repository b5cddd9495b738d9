"""A layout in words and tables: for the terminal and the report."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cadcam.arrays import Array, significant
from cadcam.plan.assessment.assess import Outcome
from cadcam.plan.choice.problem import MEASURED, Score
from cadcam.plan.layout import CandidateSurvey, Layout
from cadcam.plan.scene.layout_scene import CalibratedFrom, LayoutScene, Sigmas
from cadcam.plan.sight.candidate import Candidate, share_errors
from cadcam.plan.sight.datum import USUAL_PX
from cadcam.plan.sight.visibility import Why
from cadcam.plan.what_if import WhatIf
from cadcam.report.table import Table
from cadcam.verify.reasons import LIMIT_DIGITS, vector_words, way_words
from cadcam.verify.tolerances.tolerance import Limit, Rule

CAUSES = {"pixels": "pixel noise", "calibration": "calibration", "motion": "motion", "plane": "height of the plane"}


def layout_tables(layout: Layout, changes: Sequence[WhatIf] = ()) -> list[Table]:
    """Return the cameras, the limits, and what if."""
    tables = [camera_table(layout), limit_table(layout)]
    return [*tables, what_if_table(changes)] if changes else tables


def headline(layout: Layout) -> str:
    """Return the verdict's reason, one sentence."""
    outcomes, wanted = layout.outcomes, layout.survey.scene.tur
    n, total = outcomes.count(Outcome.SUITABLE), len(outcomes)
    cameras, one = _cameras(layout), _cameras(layout).startswith(("one", "1 "))
    if n == total:
        return f"{cameras} measure{'s' * one} all {total} limits with U at most 1/{wanted:g} of each, in every pose"
    worst = int(np.argmin(layout.assessment.ratio.min(axis=0)))
    name = layout.survey.scene.features[layout.survey.asked.feature[worst]].name
    reached = f"{cameras} reach{'es' * one} 1/{wanted:g} for {n} of {total} limits"
    said = f"{reached}; worst: {name}, {ratio_words(_least(layout, worst))}"
    if layout.outcome is Outcome.MARGINAL:
        return said + "; parts near a limit will stay undecided"
    return said


def _cameras(layout: Layout) -> str:
    n = len(layout.chosen)
    moved = {c.shared for c in layout.cameras}
    if len(moved) == 1 and "" not in moved:
        return f"one camera at {n} places"
    return f"{n} cameras" if n > 1 else "1 camera"


def camera_table(layout: Layout) -> Table:
    """Return the mounting position of each chosen camera, its lens, and its purpose."""
    rows = []
    for camera, role, view in zip(layout.cameras, layout.roles, layout.visibility, strict=True):
        pan, tilt = pan_tilt(camera)
        seen = view.seen
        scale = f"{np.median(view.mm_per_px[seen]):.3f}" if seen.any() else ""
        of = f"{role.sees} of {seen.shape[1]}"
        places = (_xyz(camera.eye), _xyz(camera.aim), f"{pan:.1f}", f"{tilt:.1f}")
        said = why(role.without, role.only_it, camera)
        rows.append((camera.name, lens_words(camera), *places, scale, of, said))
    heads = ("camera", "lens", "position mm", "aims at mm", "pan deg", "tilt deg", "mm per px", "sees", "why")
    notes = [
        "world axes; pan from x towards y, tilt up; every camera's own x axis is level, but where it looks straight up "
        "or down",
        search_words(layout),
        growth_words(layout),
    ]
    return Table(f"Cameras: {_cameras(layout)} of {len(layout.survey.candidates)} candidates", heads, tuple(rows),
                 ("camera", "lens", "why"), tuple(notes))  # fmt: skip


def why(without: Score, only_it: int, camera: Candidate) -> str:
    """Return the loss without a camera."""
    if camera.fixed:
        return "is there already"
    if only_it:
        return f"{only_it} limit{'s' * (only_it > 1)} measured only with it"
    return f"without it the worst TUR is {without.worst:.2g}"


def search_words(layout: Layout) -> str:
    """Return the method by which the set was found."""
    found, all_of_them = layout.found, layout.all_of_them
    if not found.chosen:
        return "nothing was chosen: the cameras are those that are there"
    if found.complete and found.sets == 1:
        return "all candidates are taken"
    how = (
        f"all {found.sets} sets were tried: no other is better"
        if found.complete
        else f"{found.sets} start{'s' * (found.sets > 1)}, {found.exchanges} exchanges; not every set was tried"
    )
    unmeasured = f", {all_of_them.unmeasured} not measured even then" if all_of_them.unmeasured else ""
    alone = ", if each place erred by itself" * share_errors(layout.survey.candidates)
    worst = f"with every candidate at once the worst TUR would be {tur_words(all_of_them.worst)}"
    return f"{how}; {worst}{alone}{unmeasured}"


def growth_words(layout: Layout) -> str:
    """Return the effect of one camera less or more."""
    said = [
        f"{n} cameras {tur_words(score.worst)}"
        + (f" ({score.unmeasured} limits not measured)" if score.unmeasured else "")
        for n, score in layout.growth
    ]
    return f"worst TUR by number of cameras: {', '.join(said)}"


def limit_table(layout: Layout) -> Table:
    """Return one line for each limit, in its worst pose; the outcome in the title."""
    rows = [limit_cells(layout, i) for i in range(len(layout.survey.asked))]
    heads = ("feature", "what", "limit", "U", "TUR", "cameras", "outcome", "mostly by", "direction", "pose")
    left = ("feature", "what", "outcome", "mostly by", "direction", "pose")
    return Table(
        f"{layout.outcome.value}: {headline(layout)}", heads, tuple(rows), left, (rule_words(layout.survey.scene),)
    )


def limit_cells(layout: Layout, i: int) -> tuple[str, ...]:
    """Return the cells of one limit, in its worst pose."""
    seen, found = layout.survey, layout.assessment
    limit, pose = seen.asked.limits[i], int(found.worst_pose[i])
    sigma, ratio = float(found.sigma[pose, i]), float(found.ratio[pose, i])
    outcome = layout.outcomes[i]
    what = limit.quantity.name.lower() + way_words(limit)
    name = seen.scene.features[seen.asked.feature[i]].name
    cameras = int(found.cameras[pose, i])
    poses = list(seen.scene.poses)
    if outcome is Outcome.NOT_MEASURED:
        said = "no camera sees it" if cameras == 0 else "its rays do not fix it"
        return (name, what, in_unit(limit, limit.value), "", "", str(cameras), outcome.value, said, "", poses[pose])
    shares = {cause: float(s[pose, i]) for cause, s in found.shares.items()}
    cause = max(shares, key=lambda c: shares[c])
    by = f"{CAUSES.get(cause, cause)} {shares[cause]:.0%}"
    direction = vector(found.direction[pose, i])
    U = f"{limit.quantity.per_unit * limit.k * sigma:#.3g}".rstrip(".") + f" {limit.quantity.unit}"
    return (name, what, in_unit(limit, limit.value), U, tur_words(ratio), str(cameras), outcome.value, by, direction,
            poses[pose])  # fmt: skip


def sight_table(layout: Layout, *, pose: int = 0) -> Table:
    """Return each chosen camera's view of each feature in a pose: scale, slant, blur, sigma; or why there is none."""
    rows = []
    names = [f.name for f in layout.survey.scene.features]
    for f, name in enumerate(names):
        for camera, view in zip(layout.cameras, layout.visibility, strict=True):
            why_not = Why(int(view.why[pose, f]))
            if why_not is not Why.SEEN:
                rows.append((name, camera.name, why_not.words, "", "", "", ""))
                continue
            slant = float(np.degrees(view.incidence[pose, f]))
            numbers = (view.mm_per_px[pose, f], view.blur_px[pose, f], view.sigma_px[pose, f])
            scale, blur, sigma = (f"{x:.3f}" for x in numbers)
            rows.append((name, camera.name, "seen", scale, "" if np.isnan(slant) else f"{slant:.0f}", blur, sigma))
    heads = ("feature", "camera", "", "mm per px", "slant deg", "defocus px", "sigma px")
    note = "sigma: of the place in this picture by noise, blur and slant alone, its worst direction"
    name = list(layout.survey.scene.poses)[pose]
    return Table(f"Each feature from each camera (pose {name})", heads, tuple(rows), heads[:3], (note,))


def what_if_table(changes: Sequence[WhatIf]) -> Table:
    """Return the table of changes."""
    rows = [
        (w.change, "", "", "", "", w.impossible)
        if w.impossible
        else (
            w.change,
            tur_words(w.worst) if w.worst > 0 else "none",
            str(w.suitable),
            str(w.marginal),
            str(w.failed),
            "",
        )
        for w in changes
    ]
    heads = ("what if", "worst TUR", "suitable", "marginal", "fail", "")
    note = "limits by outcome; the cameras stay where they are unless the distance is changed, and are focused anew"
    return Table("What if", heads, tuple(rows), ("what if", ""), (note,))


def next_table(
    seen: CandidateSurvey, have: Sequence[int], order: Sequence[tuple[Candidate, Score]], *, most: int = 10
) -> Table:
    """Return the candidates that add most to the existing cameras."""
    now = seen.score(have)
    rows = [("(as it is)", "", "", _worst(now), str(now.unmeasured), "")]
    for camera, score in list(order)[:most]:
        less = less_uncertain(seen.ratios(have), seen.ratios([*have, seen.candidates.index(camera)]))
        smaller = "" if less is None else f"{100 * less:.0f} % smaller"
        rows.append((camera.name, lens_words(camera), _xyz(camera.eye), _worst(score), str(score.unmeasured), smaller))
    names = ", ".join(seen.candidates[i].name for i in have)
    heads = ("next camera", "lens", "position mm", "worst TUR", "not measured", "U, mean")
    note = (
        "each by itself beside them; not measured: limits, over all poses; worst TUR and U: of those that are measured"
    )
    return Table(f"Next camera beside {names or 'none'}", heads, tuple(rows), ("next camera", "lens"), (note,))


def less_uncertain(before: Array, after: Array) -> float | None:
    """Return the share by which the uncertainty of what was measured decreases, geometric mean; None if nothing was.

    before, after: the ratios limit/U (n,) of the same limits.
    """
    measured = before > MEASURED
    if not measured.any():
        return None
    return float(1 - np.exp(np.mean(np.log(before[measured] / after[measured]))))


def _worst(score: Score) -> str:
    return tur_words(score.worst) if score.worst > 0 else "none"


def assumptions(layout: Layout) -> list[str]:
    """Return the assumptions of the prediction, one sentence each."""
    scene = layout.survey.scene
    finder, seeing = scene.finder, scene.seeing
    out = []
    if finder.sigma_px is not None:
        out.append(
            f"A feature that faces the camera in focus is found to {finder.sigma_px:g} px (sigma of each coordinate)."
        )
    if finder.by_gray:
        out.append(
            f"Marks and edges of known size are found as well as noise of {finder.gray:g} and contrast "
            f"{finder.contrast:g} (white = 1) allow (Cramer-Rao bound)."
        )
    out.append(f"An edge in focus is blurred by {finder.blur_px:g} px (sigma: lens, sensor and pixel), if not by more.")
    if finder.floor_px:
        out.append(f"No feature is found better than to {finder.floor_px:g} px.")
    out.append(calibration_words(scene.calibration))
    if own := sorted({c.type.name for c in layout.cameras if c.type.estimate is not None}):
        alike = ", alike wherever the camera stands" if share_errors(layout.cameras) else ""
        out.append(f"Of {', '.join(own)} the internals err as the camera file states instead{alike}.")
    if any(c.shared for c in layout.cameras):
        out.append(
            f"Each motion of the camera is known to {_sigmas(scene.motion)}; its calibration errs alike everywhere."
        )
    if scene.placement != Sigmas():
        out.append(f"The part lies in its pose to {_sigmas(scene.placement)}: counts for features on known planes.")
    out.append(
        f"Seen: at most {np.degrees(seeing.incidence):g} deg from the normal, defocus at most {seeing.blur_px:g} px, "
        f"{seeing.border_px:g} px from the border, at least {seeing.least_px:g} px large, {seeing.share:.0%} of a rim "
        "or an edge unhidden."
    )
    poses = ", ".join(list(scene.poses)[:6]) + (" ..." if len(scene.poses) > 6 else "")
    out.append(
        f"The part is as drawn and lies in one of {len(scene.poses)} poses ({poses}); light and contrast suffice."
    )
    world = "U is that of a place in the world, as cadcam measure finds it."
    if scene.datum:
        judged = ", ".join(scene.features[i].name for i in scene.judged)
        out.append(
            f"U of {judged} is that of cadcam verify: relative to {', '.join(s.part for s in scene.datum)} in the same "
            f"pictures, each edge off as a whole by {finder.floor_px or USUAL_PX:g} px, all of the same contrast."
        )
        world = f"Of all others {world}" if len(scene.judged) < len(scene.features) else ""
    else:
        world += (
            " What cadcam verify finds is relative to a datum in the same photos: name it in the scene to have that."
        )
    out += [world] if world else []
    out.append("Features found wrongly, vibration, temperature and the part's own deformation are not in the numbers.")
    if layout.survey.left_out:
        n = len(layout.survey.left_out)
        out.append(f"{n} places of zones lie inside of {layout.survey.left_out[0][1]} and were left out.")
    return out


def calibration_words(assumed: Sigmas | CalibratedFrom) -> str:
    """Return the assumptions on calibrations."""
    if isinstance(assumed, CalibratedFrom):
        known = f", known to {assumed.points_mm:g} mm each" if assumed.points_mm else ""
        return (
            f"Each camera is calibrated where it stands from {assumed.points} points over its picture and the part's "
            f"depth, seen to {assumed.sigma_px:g} px{known}: place, focal length and principal point."
        )
    if assumed == Sigmas():
        return "Calibrations are taken as perfect."
    return f"Calibrations are known to {_sigmas(assumed)}, independently."


def rule_words(scene: LayoutScene) -> str:
    """Return the decision rules."""
    simple = any(limit.rule is Rule.SIMPLE for f in scene.features for limit in f.limits)
    said = (
        f"U = k sigma of the worst direction, TUR = limit/U. SUITABLE: TUR at least {scene.tur:g} in every pose; "
        "MARGINAL: parts within limit - U can PASS (ISO 14253-1); UNSUITABLE: U is as large as the limit, nothing "
        "could ever PASS"
    )
    return said + (", or, with simple acceptance, more than a third of it" if simple else "")


def tur_words(ratio: float) -> str:
    """Return a test uncertainty ratio to three digits."""
    return f"{ratio:.2f}" if ratio < 9.995 else f"{ratio:.1f}"


def ratio_words(ratio: float) -> str:
    """Return a ratio as text."""
    return f"TUR {tur_words(ratio)}" if ratio > 0 else "not measured"


def lens_words(camera: Candidate) -> str:
    """Return a short name of sensor and lens."""
    optics = camera.optics
    if optics is None:
        return camera.type.name
    aperture = f" f/{optics.f_number:g}" if optics.f_number is not None else ""
    return f"{optics.sensor.name}, {optics.focal_mm:g} mm{aperture}"


def pan_tilt(camera: Candidate) -> tuple[float, float]:
    """Return the direction of view in degrees: pan from the world's x towards y, tilt upwards."""
    x, y, z = camera.viewpoint.camera_from_world.rotation[2]
    return float(np.degrees(np.arctan2(y, x))), float(np.degrees(np.arcsin(np.clip(z, -1, 1))))


def in_unit(limit: Limit, value: float) -> str:
    """Return a value of a limit's quantity with its unit."""
    return f"{significant(limit.quantity.per_unit * value, LIMIT_DIGITS)} {limit.quantity.unit}"


def vector(v: Array) -> str:
    """Return a direction; its sign is arbitrary: the largest number is shown positive."""
    return vector_words(v * np.sign(v[np.argmax(np.abs(v))]))


def _least(layout: Layout, i: int) -> float:
    return float(layout.assessment.ratio[:, i].min())


def _xyz(p: Array) -> str:
    return " ".join(f"{x:.0f}" for x in p)


def _sigmas(s: Sigmas) -> str:
    said = [
        f"{value:g} {unit}" + (f" ({what})" if what else "")
        for value, unit, what in (
            (s.position_mm, "mm", ""),
            (float(np.degrees(s.rotation)), "deg", ""),
            (s.focal_px, "px", "focal length"),
            (s.principal_point_px, "px", "principal point"),
        )
        if value
    ]
    return ", ".join(said) or "exactly"
