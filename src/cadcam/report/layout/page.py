"""A layout as one HTML file to sign: the verdict on top, mounting positions, predicted uncertainties, assumptions.

The page loads nothing else.
"""

from __future__ import annotations

import os
from base64 import b64encode
from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from html import escape

import numpy as np

from cadcam import __version__
from cadcam.arrays import Array, Picture
from cadcam.image.picture import encoded
from cadcam.plan.assessment.assess import Outcome
from cadcam.plan.choice.problem import Score
from cadcam.plan.coverage import Painting
from cadcam.plan.layout import Layout
from cadcam.plan.sight.candidate import Candidate
from cadcam.plan.what_if import WhatIf
from cadcam.record.record import in_utc
from cadcam.report.layout.model import model_figure
from cadcam.report.layout.plan import NOTHING, WANTED, floor_plan, full_bar, ratio_bar
from cadcam.report.layout.words import (
    assumptions,
    growth_words,
    headline,
    lens_words,
    limit_cells,
    next_table,
    pan_tilt,
    rule_words,
    search_words,
    sight_table,
    what_if_table,
    why,
)
from cadcam.report.page import cards, named, page, row, section
from cadcam.report.solid.figure import HOW_TO_TURN, solid_script, solid_style
from cadcam.report.table import Table
from cadcam.whole import utf8, write_whole

COLORS = {
    Outcome.SUITABLE: "#00785a",
    Outcome.MARGINAL: "#946200",
    Outcome.UNSUITABLE: "#c23b00",
    Outcome.NOT_MEASURED: "#8a1f5c",
}
_PLANS = (("From above (x to the right, y up)", (0, 1)), ("From the side (x to the right, z up)", (0, 2)))
_STYLE = """
img{width:100%;height:auto;display:block;border-radius:6px;border:1px solid var(--line)}
svg.bar{width:150px;height:24px}
.num{white-space:nowrap}td:last-child{overflow-wrap:anywhere;min-width:7em}
.legend{margin:.6rem 0}.legend i{width:16px;height:16px;border:1px solid #888}
.sign{display:grid;grid-template-columns:repeat(3,1fr);gap:24px}.sign div{padding-top:56px;border-bottom:1px solid #333}
.sign p{margin:.3rem 0 0;font-size:.9rem;color:var(--soft)}
@media(max-width:720px){.sign{grid-template-columns:1fr}}
"""


@dataclass(frozen=True, slots=True, eq=False)
class LayoutReport:
    """The page's sections beside the layout: what if, next cameras, the cameras' views, coverage with its pictures."""

    layout: Layout
    changes: Sequence[WhatIf] = ()
    following: Sequence[tuple[Candidate, Score]] = ()
    views: Sequence[Picture] = ()
    covered: Sequence[tuple[Painting, Sequence[tuple[str, Picture]]]] = ()
    time: datetime = field(default_factory=lambda: datetime.now(UTC))

    def __post_init__(self) -> None:
        object.__setattr__(self, "time", in_utc("time", self.time))


def write_layout_page(path: str | os.PathLike[str], report: LayoutReport) -> None:
    """Write the report, whole or not at all."""
    write_whole(path, utf8(layout_page(report)))


def layout_page(report: LayoutReport) -> str:
    """Return the report as one HTML document."""
    layout = report.layout
    parts = [_head(report), _limits(layout), _cameras(layout), _model(report), _where(layout)]
    parts += [_views(report), _coverage(report)]
    if report.changes:
        parts.append(section("What if", _as_cards(what_if_table(report.changes))))
    if report.following:
        table = next_table(layout.survey, layout.chosen, report.following, most=5)
        parts.append(section("If one camera more were bought", _as_cards(table)))
    parts += [_each(layout), _assumed(layout), _signatures(), _provenance(report)]
    return page(f"{layout.outcome.value}: {layout.survey.scene.name}", _STYLE + solid_style(), parts)


def _head(report: LayoutReport) -> str:
    layout = report.layout
    scene = layout.survey.scene
    what = f"Camera layout: {scene.name} · {len(scene.features)} features, {len(scene.poses)} poses"
    return (
        f'<header style="background:{COLORS[layout.outcome]}"><h1>{escape(what)}</h1>'
        f'<div class="verdict">{layout.outcome.value}</div><p>{escape(headline(layout))}.</p>'
        f"<p>{report.time:%Y-%m-%d %H:%M} UTC</p></header>"
    )


def _limits(layout: Layout) -> str:
    heads = ("feature", "what", "limit", "U", "TUR", "", "cameras", "outcome", "mostly by", "worst along", "worst pose")
    rows = []
    for i, outcome in enumerate(layout.outcomes):
        name, what, limit, U, ratio, cameras, said, by, direction, pose = limit_cells(layout, i)
        tag = f'<span class="tag" style="color:{COLORS[outcome]}">{escape(said)}</span>'
        least = float(layout.assessment.ratio[:, i].min())
        bar = ratio_bar(least, layout.survey.scene.tur, COLORS[outcome])
        plain = (escape(t) for t in (by, direction, pose))
        numbers = (_number(limit), _number(f"± {U}" if U else ""), _number(ratio))
        cells = [f"<b>{named(name)}</b>", escape(what), *numbers, bar, cameras, tag, *plain]
        rows.append(row(heads, cells))
    wanted = layout.survey.scene.tur
    keys = (
        f'<div class="legend"><span>bar: TUR from 0 to {full_bar(wanted):g}</span>'
        f'<span><i style="background:{NOTHING};width:3px"></i>1: below it nothing could ever PASS</span>'
        f'<span><i style="background:{WANTED};width:3px"></i>{wanted:g}: what is wanted</span></div>'
    )
    note = f'<p class="soft">{escape(rule_words(layout.survey.scene))}. Directions are in part axes.</p>'
    return section("What will be measured", cards(heads, "".join(rows)) + keys + note)


def _cameras(layout: Layout) -> str:
    heads = ("camera", "lens", "position mm", "aims at mm", "pan, tilt", "focus", "field", "sharp", "sees", "why")
    rows = []
    for number, (camera, role, view) in enumerate(zip(layout.cameras, layout.roles, layout.visibility, strict=True), 1):
        pan, tilt = pan_tilt(camera)
        focus, field_of_view, sharp = _optics(camera)
        cells = [
            f"<b>{named(f'{number}: {camera.name}')}</b>",
            escape(lens_words(camera)),
            _xyz(camera.eye),
            _xyz(camera.aim),
            f"{pan:.1f}°, {tilt:.1f}°",
            focus,
            field_of_view,
            sharp,
            f"{role.sees} of {view.seen.shape[1]} features",
            escape(why(role.without, role.only_it, camera)),
        ]
        rows.append(row(heads, cells))
    notes = (
        "World axes, mm. Pan turns from the world's x towards y, tilt upwards; the camera's own x axis is level. "
        "Field: what is seen at the distance in focus; sharp: where a point blurs by a pixel at most.",
        f"How they were found: {search_words(layout)}; {growth_words(layout)}.",
    )
    said = "".join(f'<p class="soft">{escape(note)}</p>' for note in notes)
    return section("Where to mount the cameras", cards(heads, "".join(rows)) + said)


def _optics(camera: Candidate) -> tuple[str, str, str]:
    optics = camera.optics
    if optics is None:
        return "as calibrated", "", ""
    width, height = optics.field_mm
    sharp = ""
    if optics.f_number is not None:
        near, far = optics.depth_of_field()
        sharp = f"{near:.0f} to {far:.0f} mm" if np.isfinite(far) else f"from {near:.0f} mm"
    return f"{optics.distance_mm:.0f} mm", f"{width:.0f} x {height:.0f} mm, {optics.mm_per_pixel[0]:.3f} mm/px", sharp


def _model(report: LayoutReport) -> str:
    note = f"{HOW_TO_TURN} Each camera's field is drawn as far as it aims; the part is in its first pose."
    figure = model_figure(report.layout, [painting for painting, _ in report.covered])
    return section("The cameras around the part", f'{figure}<p class="soft">{note}</p>{solid_script()}')


def _where(layout: Layout) -> str:
    cells = "".join(f"<div><h3>{t}</h3>{floor_plan(layout, axes)}</div>" for t, axes in _PLANS)
    note = (
        "Cameras with what they see at the distance in focus; grey: the part in its first pose; dots: other candidates."
    )
    return section("Seen from above and from the side", f'<div class="two">{cells}</div><p class="soft">{note}</p>')


def _views(report: LayoutReport) -> str:
    if not report.views:
        return ""
    names = [f"{number}: {c.name}" for number, c in enumerate(report.layout.cameras, 1)]
    pose = next(iter(report.layout.survey.scene.poses))
    cells = "".join(
        f"<div><h3>{escape(name)}</h3>{_image(picture, f'what {name} sees')}</div>"
        for name, picture in zip(names, report.views, strict=True)
    )
    keys = (
        '<div class="legend"><span><i style="background:#009e73"></i>feature that it sees</span>'
        '<span><i style="background:#d64d00"></i>feature that it does not see</span></div>'
    )
    return section(f"What each camera will see (pose {pose})", f'<div class="two">{cells}</div>{keys}')


def _coverage(report: LayoutReport) -> str:
    if not report.covered:
        return ""
    note = (
        "Each piece of the part's surface as a point feature, in the pose that shows or measures it worst. What two "
        "cameras see can be measured in space; inner and lower faces count too."
    )
    body = "".join(_painted(painting, views) for painting, views in report.covered)
    return section("Coverage", f'{body}<p class="soft">{note}</p>')


def _painted(painting: Painting, views: Sequence[tuple[str, Picture]]) -> str:
    """Return the pictures of a coverage painting with a legend of its colours."""
    cells = "".join(f"<div><h3>{escape(title)}</h3>{_image(picture, title)}</div>" for title, picture in views)
    keys = []
    for words, color, share in zip(painting.words, painting.colors, painting.shares, strict=True):
        if share == 0:
            continue
        rgb = ",".join(f"{255 * c:.0f}" for c in color)
        said = f"{share:.0%}" if share >= 0.005 else "less than 1%"
        keys.append(f'<span><i style="background:rgb({rgb})"></i>{escape(words)}: {said} of the surface</span>')
    return f'<div class="two">{cells}</div><div class="legend">{"".join(keys)}</div>'


def _each(layout: Layout) -> str:
    table = sight_table(layout)
    return section("", f"<details><summary>{escape(table.title)}</summary>{_as_cards(table)}</details>")


def _assumed(layout: Layout) -> str:
    lines = "".join(f"<li>{escape(s)}</li>" for s in assumptions(layout))
    return section("What was assumed", f"<ul>{lines}</ul>")


def _signatures() -> str:
    roles = ("planned by", "checked by", "released by")
    cells = "".join(f"<span><div></div><p>{role}: name, date, signature</p></span>" for role in roles)
    return section("Release", f'<div class="sign">{cells}</div>')


def _provenance(report: LayoutReport) -> str:
    heads = ("role", "file", "sha256")
    sources = report.layout.survey.scene.sources
    rows = "".join(row(heads, [escape(r), escape(p), f"<code>{s}</code>"]) for r, p, s in sources)
    made = f"cadcam {__version__}, {report.time:%Y-%m-%d %H:%M:%S} UTC"
    return section("Where it comes from", f'{cards(heads, rows)}<p class="soft">{escape(made)}</p>')


def _image(picture: Picture, alternative: str) -> str:
    data = b64encode(encoded(picture, "JPEG", quality=88)).decode()
    return f'<img alt="{escape(alternative)}" src="data:image/jpeg;base64,{data}">'


def _as_cards(table: Table) -> str:
    name = 0 if table.columns[0] in table.left else None  # the column of names
    rows = "".join(
        row(table.columns, [named(cell) if i == name else escape(cell) for i, cell in enumerate(cells)])
        for cells in table.rows
    )
    notes = "".join(f'<p class="soft">{escape(note)}</p>' for note in table.notes)
    return cards(table.columns, rows) + notes


def _number(text: str) -> str:
    return f'<span class="num">{escape(text)}</span>' if text else ""


def _xyz(p: Array) -> str:
    return ", ".join(f"{x:.0f}" for x in p)
