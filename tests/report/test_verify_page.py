"""The report of a verification: whole, readable in a browser, without any network."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from datetime import datetime, timedelta, timezone
from html import escape
from pathlib import Path
from typing import cast

import numpy as np
import pytest

from cadcam.camera.pose_estimate import PoseEstimate
from cadcam.errors import BadValue
from cadcam.files.jsontext import as_json
from cadcam.geometry import rotation as so3
from cadcam.geometry.rigid import Rigid
from cadcam.locate.location import Disagreement, Location
from cadcam.locate.matches import EdgeMatches
from cadcam.locate.photo import Photo
from cadcam.locate.reason import Reason
from cadcam.plan.layout import Layout
from cadcam.record.export import read_records
from cadcam.record.record import Source
from cadcam.record.trend import trend
from cadcam.render.view import Scene
from cadcam.report.layout.page import LayoutReport
from cadcam.report.locate import alternatives_table, location_as_json
from cadcam.report.verify.json import VerificationOrigin, record_of, verification_as_json
from cadcam.report.verify.model import _lines, model_figure
from cadcam.report.verify.overlay import overlay_svg
from cadcam.report.verify.page import verification_page, write_verification_page
from cadcam.report.verify.words import in_unit, to_do
from cadcam.verify.deviations.deviation import State, Unclear
from cadcam.verify.judge import Verification, verify_part
from cadcam.verify.reasons import direction_words
from cadcam.verify.tolerances.tolerance import Feature, Limit, Quantity, Selection, Tolerances, whole_parts
from cadcam.verify.tolerances.verdict import Judgement, Verdict

from ..verify.scene import CAMERA, POSE, displaced, part, photo, plate
from .browser import beyond

ORIGIN = VerificationOrigin("plate", (Source("photo", "photo.png", "0" * 64), Source("cad", "plate.step", "a" * 64)))
ASKED = Tolerances(
    (
        Feature("rib <1>", Selection("rib 1"), (Limit(Quantity.POSITION, 0.5), Limit(Quantity.PROFILE, 2.0))),
        Feature("block", Selection("block"), (Limit(Quantity.POSITION, 0.5), Limit(Quantity.PRESENCE, 0.0))),
    )
)


def at(pose: Rigid, quality: float) -> Location:
    none, ids = np.zeros(0), np.zeros(0, np.int32)
    matches = EdgeMatches(np.zeros((0, 2)), np.zeros((0, 2)), none, none, none, np.zeros((0, 3)), ids, ids)
    return Location(PoseEstimate(pose, np.zeros((6, 6))), matches, quality, Reason("as the test says"))


def test_a_photo_that_was_left_out_is_told_everywhere() -> None:
    rng = np.random.default_rng(3)
    taken = [photo(plate(), rng, name="one"), photo(plate(), rng, name="two")]
    located = replace(at(Rigid(), 1.0), disagreements=(Disagreement(0, "one", 1.25, True),))
    verdict = verify_part(part(), taken, located, ASKED)
    document = verification_as_json(verdict, ORIGIN)
    told = [{"photo": 0, "name": "one", "px": 1.25, "left_out": True}]
    assert document["disagreements"] == told == location_as_json(located, taken)["disagreements"]
    assert {e["photo"] for e in document["edges"]} == {1}
    said = "photo 'one' shows the part 1.2 px beside where all together have it, and was left out"
    assert record_of(verdict, ORIGIN).reason.endswith(said)
    assert escape(said) in verification_page(verdict, taken, ORIGIN).partition("</header>")[0]


@pytest.fixture(scope="module")
def found() -> tuple[Verification, Photo]:
    taken = photo(displaced("rib 1", np.array([0.0, 1.5, 0.0])), np.random.default_rng(3))
    return verify_part(part(), [taken], at(Rigid(), 1.0), ASKED), taken


def test_the_serial_says_that_it_is_one(found: tuple[Verification, Photo]) -> None:
    page = verification_page(found[0], [found[1]], replace(ORIGIN, serial="7"))
    assert re.search(r"<p>serial 7 · \d{4}-", page)
    assert "serial" not in verification_page(found[0], [found[1]], ORIGIN).partition("</header>")[0]


def test_what_rounds_to_nothing_has_no_sign() -> None:
    turned = Rigid(so3.exp(np.pi / 2 * np.array([-1e-9, 1.0, -1e-9])), [-1e-9, -84.0, -0.04])
    other = replace(at(Rigid(), 0.9), alternatives=(at(turned, 0.8),))
    (row,) = alternatives_table(other).rows
    assert row == ("0.800", "90.0", "0.00, 1.00, 0.00", "0.0, -84.0, 0.0")


@pytest.mark.parametrize(
    ("limit", "sigma", "said"),
    [(0.5, 0.001, "+0.004 mm 0.002"), (0.005, 0.001, "+0.0042 mm 0.0020"), (0.5, 0.0002, "+0.0042 mm 0.0004")],
)
def test_a_fine_limit_is_told_with_finer_numbers(limit: float, sigma: float, said: str) -> None:
    one = Judgement("rib", Limit(Quantity.POSITION, limit), 0.0042, sigma, Verdict.PASS)
    assert " ".join(in_unit(one)[:2]) == said


@pytest.mark.parametrize("limit", [12.34, 1250.0, 0.12345])
def test_a_limit_is_told_as_it_was_written(limit: float) -> None:
    """12.34 mm was told as 12.3 mm beside 12.325 mm that PASS."""
    one = Judgement("rib", Limit(Quantity.PROFILE, limit), 0.999 * limit, 1e-4, Verdict.PASS, "")
    assert in_unit(one)[2] == f"{limit:g} mm"


def test_a_displaced_rib_fails_and_the_block_passes(found: tuple[Verification, Photo]) -> None:
    verdicts = {(j.feature, j.limit.quantity): j.verdict for j in found[0].judgements}
    assert found[0].verdict is Verdict.FAIL
    assert verdicts["rib <1>", Quantity.POSITION] is Verdict.FAIL
    assert verdicts["block", Quantity.POSITION] is Verdict.PASS


def test_a_feature_is_datum_or_judged_by_a_limit_or_only_compared(found: tuple[Verification, Photo]) -> None:
    seen = found[0].inspection
    assert seen is not None
    named = {"rib <1>", "block"}
    told = {f["name"]: f["role"] for f in verification_as_json(found[0], ORIGIN)["features"]}
    assert all(told[name] == "judged" for name in named)
    assert {name for name, role in told.items() if role == "datum"} == {f.name for f in seen.features if f.datum}

    without = replace(found[0], judgements=())
    again = {f["name"]: f["role"] for f in verification_as_json(without, ORIGIN)["features"]}
    assert all(again[name] == "compared" for name in named)
    assert {name: role for name, role in again.items() if name not in named} == {
        name: role for name, role in told.items() if name not in named
    }


def test_what_is_the_datum_alone_has_a_color_of_its_own_and_no_finding(found: tuple[Verification, Photo]) -> None:
    seen = found[0].inspection
    assert seen is not None

    def with_plate(**of: object) -> Verification:
        features = tuple(replace(f, **of) if f.name == "plate" else f for f in seen.features)
        return replace(found[0], inspection=replace(seen, features=features))

    datum = with_plate(state=State.DATUM, why=None, displacement=None)
    unclear = with_plate(state=State.UNCLEAR, why=Unclear.POSE, displacement=None)
    told = [{f.feature: f.reason for f in record_of(v, ORIGIN).findings} for v in (datum, unclear)]
    assert told[1].keys() - told[0].keys() == {"plate"}
    assert told[1]["plate"] == f"unclear: {Unclear.POSE.value}"
    legends = [verification_page(v, [found[1]], ORIGIN, scene=Scene.of(plate())) for v in (datum, unclear)]
    assert ["background:#faeba8" in page for page in legends] == [False, True]
    assert ["</i>datum</span>" in page for page in legends] == [True, False]


def test_a_judged_feature_of_the_datum_is_judged_and_its_uncertainty_told(found: tuple[Verification, Photo]) -> None:
    """As of `datum: [{part: '*'}]`: each feature is measured from all others."""
    seen = found[0].inspection
    assert seen is not None
    features = tuple(replace(f, datum=f.datum or f.name == "rib <1>") for f in seen.features)
    every = replace(found[0], inspection=replace(seen, features=features))
    told = {f["name"]: f["role"] for f in verification_as_json(every, ORIGIN)["features"]}
    assert told["rib <1>"] == "judged"
    from_what = verification_page(every, [found[1]], ORIGIN).partition("What the uncertainty comes from")[2]
    assert '<b><span class="name">rib &lt;1&gt;</span></b>: ' in from_what.partition("</section>")[0]


def test_what_fails_is_named_with_its_size_and_labelled_with_what_was_judged(found: tuple[Verification, Photo]) -> None:
    j = found[0].judgements[0]
    said = f"{j.deviation:.2f} +- {j.U:.2f} mm"
    assert found[0].reason == f"rib <1> is {said} off its place, limit 0.5 mm; 1 more limit cannot be decided"
    page = verification_page(found[0], [found[1]], ORIGIN)
    assert f"rib &lt;1&gt;: {said.replace('+-', '±')}" in page


@pytest.mark.parametrize(
    ("quantity", "value", "off", "said"),
    [
        (Quantity.ANGLE, np.radians(0.5), np.radians(0.98), "turned by 0.98 ± 0.11 deg"),
        (Quantity.PROFILE, 0.5, -0.98, "a piece of edge -0.980 ± 0.002 mm off"),
        (Quantity.DIAMETER, 0.5, -0.98, "diameter 0.980 ± 0.002 mm less"),
        (Quantity.ANGLE, np.radians(0.97), np.radians(0.98), "1.500 ± 0.002 mm"),
    ],
)
@pytest.mark.parametrize("state", [State.DISPLACED, State.IN_PLACE])
def test_what_fails_is_labelled_with_what_fails_worst(
    found: tuple[Verification, Photo], quantity: Quantity, value: float, off: float, said: str, state: State
) -> None:
    """In photos and on the model; also a feature that is in its place."""
    verdict, taken = found
    assert verdict.inspection is not None
    rib = replace(verdict.inspection.feature("rib <1>"), state=state)
    position = Judgement("rib <1>", Limit(Quantity.POSITION, 1.4), 1.5, 0.001, Verdict.FAIL)
    other = Judgement("rib <1>", Limit(quantity, value), off, 0.001, Verdict.FAIL)
    of = replace(
        verdict, judgements=(position, other), inspection=replace(verdict.inspection, features=(rib,), edges=())
    )
    label = f"rib &lt;1&gt;: {said}"
    assert of.inspection is not None
    assert f">{label}</text>" in overlay_svg(taken, 0, of.inspection, judgements=of.judgements)
    on_model = json.dumps(f"rib <1>: {said}").replace("<", "\\u003c")
    assert f'"text":{on_model}' in model_figure(of, of.inspection, [taken], Scene.of(plate()))


def test_the_record_of_a_length_has_no_lower_limit(found: tuple[Verification, Photo]) -> None:
    along = Limit(Quantity.POSITION, 0.5, direction=np.array([0.0, 1.0, 0.0]), middle=0.1)
    limits = (Limit(Quantity.POSITION, 0.5), Limit(Quantity.POSITION, 0.5, axis=np.array([0.0, 0.0, 1.0])), along)
    of = replace(found[0], judgements=tuple(Judgement("rib <1>", one, 0.2, 0.01, Verdict.PASS) for one in limits))
    told = [(d.lower, d.upper) for d in record_of(of, ORIGIN).deviations if d.feature == "rib <1>"]
    assert told == [(None, 0.5), (None, 0.5), (-0.4, 0.6)]


def test_the_page_says_first_what_to_do(found: tuple[Verification, Photo]) -> None:
    """What failed before what is undecided, of which every limit has a remedy."""
    page = verification_page(found[0], [found[1]], ORIGIN)
    assert page.index("What to do") < page.index("What the photo shows")
    assert to_do(found[0])[0] == ("Put back into place, or have it decided whether it can stay", ["rib <1>"])
    small = Limit(Quantity.POSITION, 0.06)
    strict = Tolerances((*ASKED.features, Feature("bracket", Selection("bracket"), (small,))))
    again = verify_part(part(), [found[1]], at(Rigid(), 1.0), strict)
    undecided = [j for j in again.judgements if j.verdict is Verdict.UNDECIDED]
    assert undecided
    said = {name: what for what, names in to_do(again) for name in names}
    for j in undecided:
        assert j.remedy
        assert j.remedy[1:] in said[j.feature] or j.feature == "rib <1>"


def test_an_arrow_is_not_drawn_for_what_nobody_can_see(found: tuple[Verification, Photo]) -> None:
    """Ten micrometres, surely told, would be drawn a thousand times as long."""
    seen = found[0].inspection
    assert seen is not None
    rib = seen.feature("rib <1>")
    assert rib.displacement is not None
    assert "arrows: displacements x" in overlay_svg(found[1], 0, seen)
    tiny = replace(rib, displacement=replace(rib.displacement, value=0.005 * rib.displacement.value))
    small = replace(seen, features=(tiny,))
    assert "arrows: displacements x" not in overlay_svg(found[1], 0, small)
    assert "rib &lt;1&gt;" in overlay_svg(found[1], 0, small)


@pytest.mark.parametrize(
    ("direction", "words"), [((0, 1, 0), "y"), ((0, 0, -1), "-z"), ((0.6, 0, 0.8), "(0.60, 0.00, 0.80)")]
)
def test_a_direction_along_an_axis_has_its_name(direction: tuple[float, ...], words: str) -> None:
    assert direction_words(direction) == words


def test_the_page_fetches_nothing_and_escapes_names(found: tuple[Verification, Photo]) -> None:
    page = verification_page(found[0], [found[1]], ORIGIN)
    assert not re.search(r"(?:src|href|url)\s*[=(]\s*[\"']?\s*(?:https?:)?//", page)
    assert "<script" not in page
    assert "http" not in page
    assert "rib &lt;1&gt;" in page
    assert "rib <1>" not in page
    assert page.index("FAIL") < page.index("<svg")


def test_the_json_says_the_same_and_is_a_record(found: tuple[Verification, Photo], tmp_path: Path) -> None:
    (tmp_path / "v.json").write_bytes(as_json(verification_as_json(found[0], ORIGIN)))
    document = json.loads((tmp_path / "v.json").read_text())
    assert document["verdict_in_full"] == "FAIL"
    (record,) = read_records(tmp_path / "v.json")
    assert record.verdict == "FAIL"
    by = {(d.feature, d.kind): d for d in record.deviations}
    assert by["rib <1>", "position"].deviation == pytest.approx(found[0].judgements[0].deviation)
    without = {(j.feature, j.limit.quantity.name.lower()) for j in found[0].judgements if np.isnan(j.deviation)}
    judged = {j.feature for j in found[0].judgements}
    assert {(f.feature, f.kind) for f in record.findings if f.feature in judged} == without
    lost = record_of(replace(found[0], judgements=(replace(found[0].judgements[0], deviation=np.nan),)), ORIGIN)
    assert [d for d in lost.deviations if d.feature == "rib <1>"] == []
    assert (lost.findings[0].feature, lost.findings[0].verdict) == ("rib <1>", "FAIL")
    assert lost.findings[0].reason == found[0].judgements[0].reason


def test_what_was_found_without_limits_is_kept_without_a_verdict() -> None:
    """The rib is 1.5 mm off, the block is missing, the other rib is in place."""
    mesh = displaced("rib 1", np.array([0.0, 1.5, 0.0]))
    mesh = mesh.subset([name for name in mesh.part_names if name != "block"])
    taken = photo(mesh, np.random.default_rng(3))
    found = verify_part(part(), [taken], at(Rigid(), 1.0), whole_parts(part().scene))
    seen, record = found.inspection, record_of(found, ORIGIN)
    assert seen is not None
    states = {f.name: f.state for f in seen.features}
    assert (states["rib 1"], states["block"]) == (State.DISPLACED, State.MISSING)
    by = {d.feature: d for d in record.deviations}
    assert (by["rib 1"].deviation, by["rib 1"].expanded_uncertainty) == (
        seen.feature("rib 1").size,
        2 * seen.feature("rib 1").sigma,
    )
    assert set(by) == {name for name, state in states.items() if state in (State.IN_PLACE, State.DISPLACED)}
    assert [f.reason for f in record.findings if f.feature == "block"] == ["missing"]
    told = [*record.deviations, *record.findings]
    assert {one.feature for one in told} == {n for n, state in states.items() if state is not State.OUT_OF_VIEW}
    assert ({one.verdict for one in told}, {one.kind for one in told}, record.verdict) == ({""}, {"position"}, "")
    assert {(d.lower, d.upper) for d in record.deviations} == {(None, None)}
    after = trend([replace(record, id="before", findings=()), record, replace(record, id="after")], "block")
    assert [r.id for r in after.unchanged] == [record.id, "after"]
    assert [r.id for r in after.without] == ["before"]


def test_a_body_without_a_limit_is_kept_beside_those_that_were_judged(found: tuple[Verification, Photo]) -> None:
    """A record with verdicts says of the other bodies what one without a tolerance file says."""
    seen, record = found[0].inspection, record_of(found[0], ORIGIN)
    assert seen is not None
    judged = {j.feature for j in found[0].judgements}
    others = {f.name: f for f in seen.features if f.name not in judged and f.state is not State.OUT_OF_VIEW}
    measured = {name for name, f in others.items() if f.state in (State.IN_PLACE, State.DISPLACED)}
    assert measured == {"bracket", "plate", "rib 2"}
    kept = [one for one in (*record.deviations, *record.findings) if one.feature not in judged]
    assert sorted(one.feature for one in kept) == sorted(others)
    assert {(one.kind, one.verdict) for one in kept} == {("position", "")}
    ((_, bracket),) = trend([record], "bracket").points
    assert (bracket.deviation, bracket.lower, bracket.upper) == (others["bracket"].size, None, None)
    about = [one for one in (*record.deviations, *record.findings) if one.feature in judged]
    assert len(about) == len(found[0].judgements)  # of a feature with a limit nothing but what was judged
    assert record.verdict == "FAIL"


def test_a_part_that_was_not_found_gets_no_verdict(found: tuple[Verification, Photo]) -> None:
    lost = verify_part(part(), [found[1]], at(Rigid(), 0.1), ASKED)
    assert lost.verdict is Verdict.NOT_FOUND
    assert {j.verdict for j in lost.judgements} == {Verdict.NOT_FOUND}
    assert "as the test says" in verification_page(lost, [found[1]], ORIGIN)


LONG = "S1234_BRACKET_LEFT_OUTER_0001_REV_C_MIRRORED_COPY_OF_LONGITUDINAL_17"  # as CAD systems name bodies


def called(name: str, verdict: Verification) -> Verification:
    """Return a verification whose displaced feature has another name."""
    seen = verdict.inspection
    assert seen is not None
    features = tuple(replace(f, name=name) if f.name == "rib <1>" else f for f in seen.features)
    judgements = tuple(replace(j, feature=name) if j.feature == "rib <1>" else j for j in verdict.judgements)
    edges = tuple(replace(e, part=name) for e in seen.edges)
    return replace(verdict, judgements=judgements, inspection=replace(seen, features=features, edges=edges))


def test_the_label_of_a_long_name_keeps_its_ends_and_what_is_said_of_it(found: tuple[Verification, Photo]) -> None:
    verdict = called(LONG, found[0])
    assert verdict.inspection is not None
    (label,) = re.findall(r">(S1234[^<]*mm)</text>", overlay_svg(found[1], 0, verdict.inspection))
    assert re.fullmatch(r"S1234_BRACKET\S*…\S*LONGITUDINAL_17: \d\.\d\d ± \d\.\d\d mm", label)
    assert len(label) * 0.62 / 32 < 1  # of the photo's width: letters of a wide font, and their height


def test_numbers_after_a_name_that_is_written_leftwards_keep_their_order(found: tuple[Verification, Photo]) -> None:
    name = "\u062d\u0627\u0645\u0644"
    verdict = called(name, found[0])
    assert verdict.inspection is not None
    svg = overlay_svg(found[1], 0, verdict.inspection)
    assert re.search(rf">{name}\u200e: \d\.\d\d ± ", svg)  # without the mark browsers show U first
    assert "\u200e" not in overlay_svg(found[1], 0, called("rib", found[0]).inspection or verdict.inspection)


@pytest.mark.parametrize(("count", "all_shown"), [(12, True), (60, False)])
def test_labels_of_many_parts_in_one_spot_stay_in_the_photo_and_apart(
    found: tuple[Verification, Photo], count: int, all_shown: bool
) -> None:
    """Near its lower border, too; the farthest off are named, and how many have no room is said."""
    seen = found[0].inspection
    assert seen is not None
    rib = seen.feature("rib <1>")
    assert rib.displacement is not None
    low = seen.pose.world_from_part.inv @ POSE.inv @ (CAMERA.unproject(np.array([240.0, 340.0])) * 900.0)
    many = tuple(
        replace(
            rib, name=f"bolt {i}", p=low, displacement=replace(rib.displacement, value=(1 + i) * rib.displacement.value)
        )
        for i in range(count)
    )
    svg = overlay_svg(found[1], 0, replace(seen, features=many))
    size = float(re.findall(r'font-size="(\d+)"', svg)[0])
    boxes = []
    for x, y, end, text in re.findall(r'<text x="(\d+)" y="(\d+)"( text-anchor="end")?[^>]*>([^<]*)</text>', svg):
        length = 0.62 * size * len(text)
        left = float(x) - (length if end else 0.0)
        boxes.append((left, float(y) - 0.9 * size, left + length, float(y) + 0.25 * size, text))
        assert boxes[-1][1] > -1, text  # to the whole pixels that are written
        assert boxes[-1][3] < CAMERA.height + 1, text
    for i, (a, b, c, d, _) in enumerate(boxes):
        for left, top, right, bottom, _ in boxes[:i]:
            assert a >= right or left >= c or b > bottom - 1 or top > d - 1
    named = [text for *_, text in boxes if text.startswith("bolt")]
    assert named[0].startswith(f"bolt {count - 1}:")
    left_out = count - len(named)
    assert (left_out == 0) is all_shown
    assert (f"{left_out} more below" in svg) is not all_shown


@pytest.mark.parametrize(
    ("width", "name"),
    [
        (1280, "rib <1>"),
        (390, LONG),
        pytest.param(1280, LONG, marks=pytest.mark.slow),
        pytest.param(390, "rib <1>", marks=pytest.mark.slow),
    ],
)
def test_a_browser_shows_it_without_sideways_scrolling(
    found: tuple[Verification, Photo], tmp_path: Path, width: int, name: str
) -> None:
    """Headless Chromium, no network: it renders the page, and its own layout says that nothing is wider than it."""
    page = tmp_path / "report.html"
    write_verification_page(
        page, called(name, found[0]), [found[1]], replace(ORIGIN, part=2 * LONG), scene=part().scene
    )
    assert beyond(page, width) == [0]


@pytest.mark.parametrize("name", ["plate", LONG])
def test_on_paper_no_table_is_wider_than_its_section_and_no_row_is_split(
    found: tuple[Verification, Photo], tmp_path: Path, name: str
) -> None:
    """A4 with Chromium's margins of 0.4 inch is 717 px wide; US letter is wider. What is wider than that is cut off."""
    page = tmp_path / "report.html"
    write_verification_page(page, called(name, found[0]), [found[1]], ORIGIN, scene=part().scene)
    text = page.read_text()
    assert re.search(r"@media print\{[^@]*\btr\b[^{]*\{break-inside:avoid\}[^@]*</style>", text), (
        "after all other rules"
    )
    page.write_text(text.replace("@media print{", "@media all{"))
    sections = beyond(page, 717, "section")
    assert sections == [0] * text.count("<section")


def test_a_time_of_another_zone_is_shown_in_utc_and_one_without_a_zone_refused() -> None:
    origin = VerificationOrigin("plate", time=datetime(2026, 1, 1, 12, tzinfo=timezone(timedelta(hours=5))))
    assert origin.time.isoformat() == "2026-01-01T07:00:00+00:00"
    with pytest.raises(BadValue, match="time is 2026-01-01T12:00:00; expected a time with its zone"):
        LayoutReport(cast("Layout", None), time=datetime(2026, 1, 1, 12))
    with pytest.raises(BadValue, match="time is 2026-01-01T12:00:00; expected a time with its zone"):
        VerificationOrigin("plate", time=datetime(2026, 1, 1, 12))


def test_an_edge_of_several_photos_has_the_colour_of_the_surest(found: tuple[Verification, Photo]) -> None:
    """Whatever lies between them that no photo shows: its sigma is no number, by which nothing can be sorted."""
    scene, seen = part().scene, found[0].inspection
    assert seen is not None
    edge = next(e for e in seen.edges if np.isfinite(e.value))
    sure, vague = replace(edge, value=0.0, sigma=0.01), replace(edge, value=0.3, sigma=0.5)
    blank = replace(edge, chain=edge.chain + 1, value=np.nan, sigma=np.nan)
    of, none = scene.edges.chain == edge.chain, np.zeros(len(scene.edges), bool)
    drawn = [_lines(replace(seen, edges=edges), scene, none) for edges in ((sure, blank, vague), (vague, sure))]
    assert len({styles[int(style[of][0])].color for styles, style in drawn}) == 1
