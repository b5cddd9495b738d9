"""A layout as one JSON document: cameras to mount, limits and uncertainties in every pose, what if, assumptions."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from cadcam.files.jsontext import head_as_json, or_null, or_nulls
from cadcam.plan.choice.problem import Score
from cadcam.plan.layout import Layout
from cadcam.plan.sight.candidate import Candidate
from cadcam.plan.sight.visibility import Why
from cadcam.plan.what_if import WhatIf
from cadcam.report.layout.words import assumptions, headline, pan_tilt, rule_words


def layout_as_json(
    layout: Layout,
    changes: Sequence[WhatIf] = (),
    following: Sequence[tuple[Candidate, Score]] = (),
) -> dict[str, Any]:
    """Return the document."""
    scene = layout.survey.scene
    out: dict[str, Any] = {
        **head_as_json("cadcam layout", 1),
        "scene": scene.name,
        "outcome": layout.outcome.value,
        "reason": headline(layout),
        "worst_tur": layout.assessment.worst,
        "wanted_tur": scene.tur,
        "rule": rule_words(scene),
        "candidates": len(layout.survey.candidates),
        "complete_search": layout.found.complete,
        "worst_tur_of_all_candidates": layout.all_of_them.worst,
        "worst_tur_by_number": {str(n): score_as_json(score) for n, score in layout.growth},
        "cameras": [_camera(layout, i) for i in range(len(layout.chosen))],
        "limits": [_limit(layout, i) for i in range(len(layout.survey.asked))],
        "what_if": [_what_if(w) for w in changes],
        "assumptions": assumptions(layout),
        "left_out": [{"candidate": name, "inside_of": inside} for name, inside in layout.survey.left_out],
        "sources": [{"role": r, "path": p, "sha256": s} for r, p, s in scene.sources],
    }
    if following:
        out["next"] = next_as_json(following)
    return out


def next_as_json(order: Sequence[tuple[Candidate, Score]]) -> list[dict[str, Any]]:
    """Return candidates with the scores of the set extended by each."""
    return [{"name": c.name, "position_mm": c.eye.tolist(), **score_as_json(score)} for c, score in order]


def score_as_json(score: Score) -> dict[str, Any]:
    """Return a set's score."""
    return {"worst_tur": score.worst, "not_measured": score.unmeasured}


def _camera(layout: Layout, i: int) -> dict[str, Any]:
    camera, role, view = layout.cameras[i], layout.roles[i], layout.visibility[i]
    pan, tilt = pan_tilt(camera)
    optics = camera.optics
    lens = {} if optics is None else {
        "sensor": optics.sensor.name,
        "focal_mm": optics.focal_mm,
        "f_number": optics.f_number,
        "focus_mm": optics.distance_mm,
        "field_mm": list(optics.field_mm),
    }  # fmt: skip
    pose = camera.viewpoint.camera_from_world
    names = [f.name for f in layout.survey.scene.features]
    return {
        "name": camera.name,
        "mount": camera.mount,
        "type": camera.type.name,
        "fixed": camera.fixed,
        **lens,
        "position_mm": camera.eye.tolist(),
        "aim_mm": camera.aim.tolist(),
        "pan_deg": pan,
        "tilt_deg": tilt,
        "camera_from_world": {"rotation": pose.rotation.tolist(), "translation_mm": pose.translation.tolist()},
        "only_it": role.only_it,
        "without_it": score_as_json(role.without),
        "features": {
            name: {
                "seen": [Why(int(w)).words for w in view.why[:, f]],
                "mm_per_px": or_nulls(view.mm_per_px[:, f]),
                "incidence_deg": or_nulls(np.degrees(view.incidence[:, f])),
                "defocus_px": or_nulls(view.blur_px[:, f]),
                "sigma_px": or_nulls(view.sigma_px[:, f]),
            }
            for f, name in enumerate(names)
        },
    }


def _limit(layout: Layout, i: int) -> dict[str, Any]:
    seen, found = layout.survey, layout.assessment
    limit = seen.asked.limits[i]
    times, unit = limit.quantity.per_unit, limit.quantity.unit
    return {
        "feature": seen.scene.features[seen.asked.feature[i]].name,
        "quantity": limit.quantity.value,
        "direction": None if limit.direction is None else limit.direction.tolist(),
        "axis": None if limit.axis is None else limit.axis.tolist(),
        "k": limit.k,
        f"limit_{unit}": times * limit.value,
        "outcome": layout.outcomes[i].value,
        "worst_tur": float(found.ratio[:, i].min()),
        "poses": {
            name: {
                f"U_{unit}": or_null(times * limit.k * found.sigma[p, i]),
                "tur": float(found.ratio[p, i]),
                "cameras": int(found.cameras[p, i]),
                "worst_direction": or_nulls(found.direction[p, i]),
                "variance_by_cause": {cause: float(s[p, i]) for cause, s in found.shares.items()},
            }
            for p, name in enumerate(seen.scene.poses)
        },
    }


def _what_if(w: WhatIf) -> dict[str, Any]:
    if w.impossible:
        return {"change": w.change, "impossible": w.impossible}
    return {
        "change": w.change,
        "worst_tur": w.worst,
        "suitable": w.suitable,
        "marginal": w.marginal,
        "failed": w.failed,
    }
