"""A verification as one JSON document: a record of `cadcam.record.export` together with its evidence."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from typing import Any

import numpy as np

from cadcam.files.jsontext import or_null, or_nulls
from cadcam.image.picture import PictureInfo
from cadcam.kinds import expect, expect_each
from cadcam.record.export import record_as_json
from cadcam.record.record import Deviation, Finding, Record, Source, in_utc
from cadcam.report.locate import disagreements_as_json
from cadcam.report.photos import photos_as_json
from cadcam.report.verify.words import assumptions, role, rule_words, weakest_direction
from cadcam.verify.adjustment.datum_fit import CAUSES
from cadcam.verify.deviations.deviation import EdgeDeviation, Extra, FeatureDeviation, State
from cadcam.verify.judge import Verification
from cadcam.verify.tolerances.tolerance import Quantity
from cadcam.verify.tolerances.verdict import Judgement, Verdict

_VERDICTS = {Verdict.PASS: "PASS", Verdict.FAIL: "FAIL"}  # of a record; all else is UNDECIDED
_POSITION, _K = Quantity.POSITION.name.lower(), 2.0  # of what is kept without limits


@dataclass(frozen=True, slots=True)
class VerificationOrigin:
    """The identity of a verification: part, place, time, files; cameras: one line each; photos: how each was read."""

    part: str
    sources: tuple[Source, ...] = ()
    cameras: tuple[str, ...] = ()
    serial: str = ""
    station: str = ""
    time: datetime = field(default_factory=lambda: datetime.now(UTC))
    photos: tuple[PictureInfo, ...] = ()

    def __post_init__(self) -> None:
        expect(self.part, "part", str)
        expect(self.time, "time", datetime)
        object.__setattr__(self, "time", in_utc("time", self.time))
        for name, kind in (("sources", Source), ("cameras", str), ("photos", PictureInfo)):
            object.__setattr__(self, name, expect_each(getattr(self, name), name, kind))


def record_of(found: Verification, origin: VerificationOrigin) -> Record:
    """Return the record of a verification for a store of measured parts.

    Of each feature in view of which nothing was judged it holds the position that was measured, without limits, or
    that it is missing or why it is unclear; of what all is measured from, nothing. Where nothing was judged at all, it
    has no verdict.
    """
    expect(found, "found", Verification)
    expect(origin, "origin", VerificationOrigin)
    seen, judged = () if found.inspection is None else found.inspection.features, {j.feature for j in found.judgements}
    told = [f for f in seen if f.state not in (State.OUT_OF_VIEW, State.DATUM)]
    in_view = [f for f in told if f.name not in judged]
    measured = [f for f in in_view if f.state in (State.IN_PLACE, State.DISPLACED) and f.displacement is not None]
    return Record(
        part=origin.part,
        serial=origin.serial,
        station=origin.station,
        time=origin.time,
        pose=None if found.verdict is Verdict.NOT_FOUND or found.inspection is None else found.inspection.pose,
        quality=float(found.located.quality),
        deviations=(
            *(_deviation(j) for j in found.judgements if np.isfinite(j.deviation)),
            *(Deviation(f.name, f.size, _K * f.sigma, kind=_POSITION, k=_K) for f in measured),
        ),
        findings=(
            *(_finding(j) for j in found.judgements if not np.isfinite(j.deviation)),
            *(Finding(f.name, _POSITION, reason=_state_words(f)) for f in in_view if f not in measured),
        ),
        verdict=_VERDICTS.get(found.verdict, "UNDECIDED") if found.judgements else "",
        reason=found.reason,
        sources=origin.sources,
    )


def verification_as_json(found: Verification, origin: VerificationOrigin) -> dict[str, Any]:
    """Return the document; its head is that of a record, so that `cadcam state add` accepts it."""
    head = record_as_json(record_of(found, origin))
    out = head | {
        "verdict_in_full": found.verdict.value,
        "rule": rule_words(found),
        "judgements": [_judgement(j) for j in found.judgements],
        "cameras": list(origin.cameras),
        "photos": photos_as_json(origin.photos),
        "disagreements": disagreements_as_json(found.located),
        "assumptions": assumptions(found),
    }
    seen = found.inspection
    if seen is None or not seen.found:
        return out
    direction, sigma = weakest_direction(seen)
    return out | {
        "datum": list(seen.datum),
        "left_out_of_datum": list(seen.left_out),
        "datum_contradictions": list(seen.contradictions),
        "weakest_direction": {"motion": direction, "sigma_mm": sigma},
        "edge_error_px": seen.tau_px,
        "noise_scale": seen.noise_scale,
        "clutter": seen.clutter,
        "seen_share": seen.seen_share,
        "covered": asdict(seen.covered) if seen.covered else None,
        "features": [_feature(f) | {"role": role(found, f)} for f in seen.features],
        "edges": [_edge(e) for e in seen.edges],
        "extra": [_extra(e) for e in seen.extra],
    }


def _deviation(j: Judgement) -> Deviation:
    quantity = j.limit.quantity
    scale, (low, high) = quantity.per_unit, j.limit.bounds
    return Deviation(
        j.feature,
        scale * (j.deviation + j.limit.middle),
        scale * j.U,
        kind=quantity.name.lower(),
        unit=quantity.unit,
        k=j.limit.k,
        lower=None if j.limit.of_length else scale * low,
        upper=scale * high,
        verdict=_VERDICTS.get(j.verdict, "UNDECIDED"),
    )


def _finding(j: Judgement) -> Finding:
    return Finding(j.feature, j.limit.quantity.name.lower(), _VERDICTS.get(j.verdict, "UNDECIDED"), j.reason)


def _state_words(f: FeatureDeviation) -> str:
    """Return the state of a feature that was not measured, and why it was not."""
    return f.state.value if f.why is None else f"{f.state.value}: {f.why.value}"


def _judgement(j: Judgement) -> dict[str, Any]:
    quantity = j.limit.quantity
    out: dict[str, Any] = {"feature": j.feature, "kind": quantity.name.lower(), "verdict": j.verdict.value}
    out |= {"between": list(j.between)} if j.between else {}
    if quantity is not Quantity.PRESENCE:
        scale, unit = quantity.per_unit, quantity.unit
        out |= {
            f"limit_{unit}": scale * j.limit.value,
            f"deviation_{unit}": or_null(scale * (j.deviation + j.limit.middle)),
            **({f"middle_{unit}": j.limit.middle} if j.limit.middle else {}),
            f"expanded_uncertainty_{unit}": or_null(scale * j.U),
            "k": j.limit.k,
            "rule": j.limit.rule.value,
        }
    return out | {"reason": j.reason} | ({"remedy": j.remedy} if j.remedy else {})


def _feature(f: FeatureDeviation) -> dict[str, Any]:
    out: dict[str, Any] = {
        "name": f.name,
        "state": f.state.value,
        "edges_expected": f.presence.expected,
        "edges_seen": f.presence.seen,
        "log_likelihood_ratio_present": f.presence.log_ratio,
        "p_mm": or_nulls(f.p),
    }
    if f.why is not None:
        out["why"] = f.why.value
    if f.displacement is None:
        return out
    return out | {
        "displacement_mm": f.vector.tolist(),
        "size_mm": f.size,
        "sigma_mm": f.sigma,
        "directions_seen": f.seen.T.tolist(),
        "displacement_in_directions_mm": f.displacement.value.tolist(),
        "covariance_mm2": f.displacement.covariance.tolist(),
        "covariance_by_cause_mm2": {c: getattr(f.displacement, c).tolist() for c in CAUSES},
        "turn_deg": or_null(np.degrees(f.turn)),
        "turn_sigma_deg": or_null(np.degrees(f.turn_sigma)),
        "turn_axis": or_nulls(f.axis),
        "p_value": or_null(f.p_value),
    }


def _edge(e: EdgeDeviation) -> dict[str, Any]:
    return {
        "part": e.part,
        "kind": e.kind,
        "chain": e.chain,
        "photo": e.photo,
        "features": list(e.features),
        "deviation_mm": or_null(e.value),
        "sigma_mm": or_null(e.sigma),
        "variance_by_cause_mm2": dict(zip(CAUSES, or_nulls(e.variances), strict=True)),
        "direction": or_nulls(e.direction),
        "p_mm": or_nulls(e.p),
        "mm_per_px": e.mm_per_px,
        "places": e.places,
        "places_seen": e.seen,
        "off": e.off,
        "stations_px_mm_mm": [or_nulls(row) for row in e.station.tolist()],
        "held_in_part_px_mm_mm": {name: [or_nulls(row) for row in part.tolist()] for name, part in e.held.items()},
    }


def _extra(e: Extra) -> dict[str, Any]:
    return {"photo": e.photo, "length_px": e.length_px, "q_px": e.q.mean(axis=0).tolist(), "near": e.near} | {
        "p_mm": or_nulls(e.p)
    }
