"""A verification as one HTML file: the verdict on top, all its evidence below; the page loads nothing else."""

from __future__ import annotations

import os
from collections.abc import Sequence
from html import escape

import numpy as np

from cadcam import __version__
from cadcam.kinds import expect, expect_each, expect_path
from cadcam.locate.photo import Photo
from cadcam.render.view import Scene
from cadcam.report.page import cards, named, page, row, section
from cadcam.report.solid.figure import solid_script, solid_style
from cadcam.report.verify.json import VerificationOrigin
from cadcam.report.verify.model import model_figure
from cadcam.report.verify.overlay import EXTRA, MISSING, UNSEEN, deviation_color, full_scale, overlay_svg
from cadcam.report.verify.plots import COLORS, edges_plot, shares_plot, stations_plot, tolerance_bar
from cadcam.report.verify.words import (
    assumptions,
    feature_notes,
    in_unit,
    role,
    rule_words,
    shares_in_words,
    to_do,
    weakest_direction,
)
from cadcam.verify.deviations.deviation import FeatureDeviation, State
from cadcam.verify.inspection import Inspection
from cadcam.verify.judge import Verification
from cadcam.verify.reasons import vector_words
from cadcam.verify.tolerances.tolerance import Quantity
from cadcam.verify.tolerances.verdict import Judgement, Verdict
from cadcam.whole import utf8, write_whole

_PLAIN = "#555555"  # of a state that is neither good nor bad
_HELD = "\u00a0"  # a space at which no line is broken
_STYLE = """
svg.photo{border-radius:6px;background:#000;margin:.5rem 0}
@media(min-width:721px){svg.photo .labels text{font-size:.6em}}svg.plot{max-width:540px}svg.bar{width:180px;height:26px}
td:last-child{overflow-wrap:anywhere;min-width:9em}
.legend i{width:22px;height:0;border-top:4px solid}
.scale{display:inline-block;width:140px;height:12px;border:1px solid var(--line);vertical-align:middle;margin:0 6px}
"""


def write_verification_page(
    path: str | os.PathLike[str],
    found: Verification,
    photos: Sequence[Photo],
    origin: VerificationOrigin,
    *,
    scene: Scene | None = None,
) -> None:
    """Write the report, whole or not at all; scene: the CAD model, which the page then shows to be turned."""
    expect_path(path)
    expect(found, "found", Verification)
    photos = expect_each(photos, "photos", Photo)
    expect(origin, "origin", VerificationOrigin)
    expect(scene, "scene", Scene, optional=True)
    write_whole(path, utf8(verification_page(found, photos, origin, scene=scene)))


def verification_page(
    found: Verification, photos: Sequence[Photo], origin: VerificationOrigin, *, scene: Scene | None = None
) -> str:
    """Return the report as one HTML document."""
    seen = found.inspection
    parts = [_head(found, origin), _to_do(found)]
    if seen is not None and seen.found:
        parts += [
            _overlays(found, seen, photos),
            _model(found, seen, photos, scene),
            _judgements(found),
            _features(found, seen),
            _plots(found, seen),
            _sensitivity(found, seen),
        ]
        parts += [_assumed(found), _edges(seen)]
    else:
        parts += [_not_found(photos), _judgements(found)]
    parts.append(_provenance(origin))
    return page(f"{found.verdict.value}: {origin.part}", _STYLE + solid_style(), parts)


def _head(found: Verification, origin: VerificationOrigin) -> str:
    serial = f"serial {origin.serial}" if origin.serial else ""
    where = " · ".join(t for t in (serial, origin.station, f"{origin.time:%Y-%m-%d %H:%M} UTC") if t)
    why = escape(found.reason.replace("+-", "±"))
    return (
        f'<header style="background:{COLORS[found.verdict]}"><h1>{escape(origin.part)}</h1>'
        f'<div class="verdict">{found.verdict.value}</div><p>{why}</p><p>{escape(where)}</p></header>'
    )


def _to_do(found: Verification) -> str:
    lines = [f"<li>{escape(what)}: <b>{named(', '.join(names))}</b></li>" for what, names in to_do(found)]
    return section("What to do", f"<ul>{''.join(lines)}</ul>") if lines else ""


def _overlays(found: Verification, seen: Inspection, photos: Sequence[Photo]) -> str:
    full = full_scale(seen)
    colors = ",".join(deviation_color(full * s, full) for s in (-1.0, -0.5, 0.0, 0.5, 1.0))
    keys = [
        f'<span>-{full:g} mm<span class="scale" style="background:linear-gradient(90deg,{colors})"></span>+{full:g} mm '
        "across the edge</span>"
    ]
    keys.append(_key(UNSEEN, "not seen", "dashed"))
    if any(f.state is State.MISSING for f in seen.features):
        keys.append(_key(MISSING, "missing", "dashed"))
    if seen.extra:
        said = "in the photo, but no edge of the CAD: shadows, rounded edges, dirt, what was added"
        keys.append(_key(EXTRA, said, "dotted"))
    views = "".join(
        (f"<h3>{escape(photo.viewpoint.name)}</h3>" if len(photos) > 1 else "")
        + overlay_svg(photo, i, seen, judgements=found.judgements)
        for i, photo in enumerate(photos)
    )
    note = "Hover over an edge, or touch it, for its deviation. The edges are drawn where the model has them."
    return section(
        "What the photo shows", f'{views}<div class="legend">{"".join(keys)}</div><p class="soft">{note}</p>'
    )


def _model(found: Verification, seen: Inspection, photos: Sequence[Photo], scene: Scene | None) -> str:
    if scene is None:
        return ""
    return section("On the model", model_figure(found, seen, photos, scene) + solid_script())


def _key(color: str, text: str, style: str = "solid") -> str:
    return f'<span><i style="border-top:4px {style} {color}"></i>{escape(text)}</span>'


def _judgements(found: Verification) -> str:
    if not found.judgements:
        return ""
    heads = ("feature", "what", "deviation", "U", "limit", "", "verdict", "why")
    rows = "".join(row(heads, _cells(j)) for j in found.judgements)
    return section("Limits", f'{cards(heads, rows)}<p class="soft">{escape(rule_words(found))}.</p>')


def _cells(j: Judgement) -> list[str]:
    deviation, U, limit = in_unit(j)
    said = f"± {U} (k {j.limit.k:.3g})".replace(" ", _HELD) if U else ""
    tag = f'<span class="tag" style="color:{COLORS[j.verdict]}">{j.verdict.value}</span>'
    what = escape(j.limit.quantity.name.lower())
    return [
        f"<b>{named(j.feature)}</b>",
        what,
        deviation.replace(" ", _HELD),
        said,
        limit.replace(" ", _HELD),
        tolerance_bar(j),
        tag,
        escape(j.reason),
    ]


def _features(found: Verification, seen: Inspection) -> str:
    heads = ("feature", "state", "edges seen", "displaced", "vector mm", "turned", "chance", "role")
    rows = "".join(
        row(heads, [*_feature_cells(f, _kept(found, f)), role(found, f)])
        for f in seen.features
        if f.state is not State.OUT_OF_VIEW
    )
    notes = [f"{note[0].upper()}{note[1:]}.".replace("+-", "±") for note in feature_notes(seen)]
    notes.insert(1, "Chance: how probable such a displacement is of a feature in place.")
    hidden = [f.name for f in seen.features if f.state is State.OUT_OF_VIEW]
    if hidden:
        notes.append(f"Not in view: {', '.join(hidden)}.")
    said = "".join(f'<p class="soft">{escape(note)}</p>' for note in notes)
    return section("Features", cards(heads, rows) + said)


def _kept(found: Verification, f: FeatureDeviation) -> bool:
    """Return whether a feature's position limit is not exceeded: then its displacement needs no correction."""
    of_position = [j for j in found.judgements if j.feature == f.name and j.limit.quantity is Quantity.POSITION]
    return bool(of_position) and all(j.verdict is not Verdict.FAIL for j in of_position)


def _feature_cells(f: FeatureDeviation, kept: bool) -> list[str]:
    failed = COLORS[Verdict.FAIL]
    colors = {State.DISPLACED: _PLAIN if kept else failed, State.MISSING: failed, State.IN_PLACE: "#00785a"}
    state = f'<span class="tag" style="color:{colors.get(f.state, _PLAIN)}">{f.state.value}</span>'
    cells = [f"<b>{named(f.name)}</b>", state, f"{f.presence.seen} of {f.presence.expected}"]
    if f.displacement is None:
        return [*cells, "", "", "", ""]
    turn, U = np.degrees(f.turn), np.degrees(2 * f.turn_sigma)
    turned = f"{round(float(turn), 3) + 0.0:+.3f} ± {U:.3f} deg" if np.isfinite(U) else ""
    size = f"{f.size:.3f} ± {2 * f.sigma:.3f} mm"
    return [*cells, size, vector_words(f.vector), turned, f"{f.p_value:.2g}"]


def _plots(found: Verification, seen: Inspection) -> str:
    names = dict.fromkeys(j.feature for j in found.judgements)
    names |= dict.fromkeys(f.name for f in seen.features if f.state is State.DISPLACED)
    drawn = [("All edges: deviation and U (k 2)", edges_plot(seen))]
    drawn += [(f"Along the edges of {name}", stations_plot(seen, name)) for name in names]
    cells = "".join(f"<div><h3>{escape(title)}</h3>{svg}</div>" for title, svg in drawn if svg)
    return section("Deviations", f'<div class="two">{cells}</div>')


def _sensitivity(found: Verification, seen: Inspection) -> str:
    measured = [f for f in seen.features if f.displacement is not None]
    shown = [f for f in measured if role(found, f) != "datum"] or measured
    direction, sigma = weakest_direction(seen)
    lines = [f"<li><b>{named(f.name)}</b>: {escape(shares_in_words(f))} of the variance</li>" for f in shown]
    pose = f"Weakest motion of the pose: {direction}, 1 sigma {sigma:.3f} mm at the edges (part axes)."
    words = f"<ul>{''.join(lines)}</ul><p>{escape(pose)}</p>"
    both = f'<div class="two"><div>{shares_plot(shown)}</div><div>{words}</div></div>'
    return section("What the uncertainty comes from", both)


def _assumed(found: Verification) -> str:
    return section("What is assumed", "<ul>" + "".join(f"<li>{escape(s)}</li>" for s in assumptions(found)) + "</ul>")


def _edges(seen: Inspection) -> str:
    heads = ("edge", "of", "seen", "deviation", "direction seen", "mm per px")
    rows = []
    for e in sorted(seen.edges, key=lambda e: -abs(e.value) if np.isfinite(e.value) else 0.0):
        value = f"{e.value:+.3f} ± {2 * e.sigma:.3f} mm" if np.isfinite(e.value) else "not seen"
        mark = " <b>(off)</b>" if e.off else ""
        share = f"{e.seen} of {e.places} places"
        cells = [
            f"{e.kind} {e.chain}",
            named(e.part),
            share,
            value + mark,
            vector_words(e.direction),
            f"{e.mm_per_px:.3f}",
        ]
        rows.append(row(heads, cells))
    said = (
        "Each against a pose fitted without it, ± 2 sigma; the direction (part axes) is that of a positive deviation."
    )
    table = f'{cards(heads, "".join(rows))}<p class="soft">{said}</p>'
    return section("", f"<details><summary>All {len(seen.edges)} edges</summary>{table}</details>")


def _not_found(photos: Sequence[Photo]) -> str:
    from cadcam.image.svg import svg_text

    views = []
    for photo in photos:
        svg = svg_text(photo.camera.size, [], photo=photo.gray)
        views.append('<svg class="photo" ' + svg[svg.index("viewBox") :].replace("xlink:href", "href"))
    return section("The photo", "".join(views))


def _provenance(origin: VerificationOrigin) -> str:
    heads = ("role", "file", "sha256")
    rows = "".join(row(heads, [escape(s.role), escape(s.path), f"<code>{s.sha256}</code>"]) for s in origin.sources)
    cameras = "".join(f'<p class="soft">{escape(line)}</p>' for line in origin.cameras)
    made = f"cadcam {__version__}, {origin.time:%Y-%m-%d %H:%M:%S} UTC"
    return section("Where it comes from", f'{cards(heads, rows)}{cameras}<p class="soft">{escape(made)}</p>')
