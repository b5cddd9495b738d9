"""`cadcam state`: the measurements of each part, stored, queried, exported."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Iterator, Sized
from contextlib import suppress
from datetime import UTC, date, datetime, time
from itertools import chain, islice
from typing import TYPE_CHECKING, Any

from cadcam.cli.arguments import Run, Verbs, add_jobs, add_json, job, verb, whole
from cadcam.cli.output import check_target, print_json, print_tables, say
from cadcam.cli.stores import STORE_HELP, add_store_option, store_address
from cadcam.errors import BadValue, UnknownName, UnusableStore

if TYPE_CHECKING:
    from cadcam.record.record import Record
    from cadcam.record.store import Store, Which

_SHORT_ID = 6
_FIRST = 500  # records that are read before a store is created
_DESCRIPTION = """\
Keep what was measured of each part: pose, deviations with their uncertainties, verdict, the fingerprints of photo, CAD
and camera, time and station. Records are only added, never changed. Once `add` has said so, a record is on the disk;
several stations may write to one store."""
_EXAMPLES = f"""\
  cadcam state add verify.json --serial 4711 --station "cell 3"
  cadcam state list --part bracket --verdict FAIL --since 2026-03-01
  cadcam state show 3f2a91c0
  cadcam state trend stiffener --part bracket
  cadcam state page -o parts.html --part bracket --since 2026-03-01
  cadcam state list --source camera.json
  cadcam state export -o all.csv --store postgresql://user:password@server/yard

{STORE_HELP}
what is exported as .json or .jsonl can be added to another store; .csv is for spreadsheets: one line per deviation."""


def add_to(verbs: Verbs) -> None:
    """Add the verb and its jobs."""
    short = "keep what was measured of each part; list, trend, export"
    parser = verb(verbs, "state", None, short=short, description=_DESCRIPTION, examples=_EXAMPLES)
    jobs = add_jobs(parser)
    _add_add(jobs)
    _add_list(jobs)
    _add_show(jobs)
    _add_trend(jobs)
    _add_page(jobs)
    _add_export(jobs)


def _job(jobs: Verbs, name: str, run: Run, short: str) -> argparse.ArgumentParser:
    parser = job(jobs, name, run, short=short)
    add_store_option(parser)
    add_json(parser)
    return parser


def _add_add(jobs: Verbs) -> None:
    parser = _job(jobs, "add", run_add, "keep the results in JSON files of `cadcam verify`, or exported records")
    parser.add_argument("files", nargs="+", metavar="FILE", help="JSON of `cadcam verify`, or an export")
    for name, what in (
        ("part", "kind of part"),
        ("serial", "serial number of the part"),
        ("station", "where it was measured"),
    ):
        parser.add_argument(f"--{name}", metavar="NAME", help=f"{what}, in place of what the file says")


def _add_list(jobs: Verbs) -> None:
    parser = _job(jobs, "list", run_list, "list records, the latest at the end")
    _add_filters(parser)
    _add_newest(parser, "no more than the latest N (default 30)")


def _add_show(jobs: Verbs) -> None:
    parser = _job(jobs, "show", run_show, "show all that one record holds")
    parser.add_argument("id", metavar="ID", help=f"the record's id, or its beginning ({_SHORT_ID} characters or more)")


def _add_trend(jobs: Verbs) -> None:
    short = "show a feature's deviation or presence over the parts: mean, sigma, verdicts, since when"
    parser = _job(jobs, "trend", run_trend, short)
    parser.add_argument("feature", metavar="FEATURE", help="the feature's name, as in the tolerance file")
    parser.add_argument(
        "--kind", metavar="NAME", help="which of its judgements, where it has several: position, angle, presence ..."
    )
    _add_filters(parser)
    _add_newest(parser, "a line for no more than the latest N (default 30); mean and sigma are of all")


def _add_page(jobs: Verbs) -> None:
    parser = _job(jobs, "page", run_page, "write a page: verdicts, what fails, charts of each feature, every part")
    parser.add_argument("-o", "--output", required=True, metavar="FILE", help="page to write: .html")
    _add_filters(parser)
    _add_newest(parser, "of no more than the latest N (default 300)", 300)


def _add_export(jobs: Verbs) -> None:
    parser = _job(jobs, "export", run_export, "write records to a file")
    parser.add_argument(
        "-o",
        "--output",
        required=True,
        metavar="FILE",
        help="file to write: .csv (one line per deviation), .json or .jsonl (everything)",
    )
    _add_filters(parser)


def _add_filters(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("which records (default: all)")
    group.add_argument("--part", metavar="NAME", help="kind of part")
    group.add_argument("--serial", metavar="NAME", help="serial number of the part")
    group.add_argument("--station", metavar="NAME", help="where it was measured")
    verdicts = ("PASS", "FAIL", "UNDECIDED")
    group.add_argument("--verdict", type=str.upper, choices=verdicts, help="verdict on the part as a whole")
    group.add_argument(
        "--source", metavar="FILE", help="measured with this file: photo, CAD, camera or tolerances, by its contents"
    )
    group.add_argument(
        "--since", type=_when, metavar="TIME", help="measured then or later: 2026-03-01 or 2026-03-01T14:30, UTC"
    )
    group.add_argument("--until", type=_when, metavar="TIME", help="measured then or earlier; a day counts to its end")


def _add_newest(parser: argparse.ArgumentParser, what: str, most: int = 30) -> None:
    parser.add_argument("--newest", type=whole, default=most, metavar="N", help=what)


def _records(arguments: argparse.Namespace) -> Iterator[Record]:
    from dataclasses import replace

    from cadcam.record.export import each_record

    given = {name: value for name in ("part", "serial", "station") if (value := getattr(arguments, name)) is not None}
    for file in arguments.files:
        for record in each_record(file):
            yield replace(record, **given)


def run_add(arguments: argparse.Namespace) -> None:
    """Store records; a new store is created only once the first of them could be read."""
    from cadcam.record.store import open_store
    from cadcam.report.table import counted, spelled

    added: list[tuple[str, str]] = []  # ids, and what is printed: the records themselves may be many

    def noted(records: Iterable[Record]) -> Iterator[Record]:
        for record in records:
            added.append((record.id, spelled(f"{record.part} {record.serial} {record.verdict}".rstrip())))
            yield record

    records = _records(arguments)
    first = list(islice(records, _FIRST))
    with open_store(store_address(arguments)) as store:
        store.add_all(noted(chain(first, records)))
    if arguments.json:
        print_json({"store": store.name, "added": [name for name, _ in added]})
    else:
        for name, words in added:
            print(f"{name}  {words}")
        say(f"{counted(len(added), 'record')} added to {store.name}")


def _why_none(store: Store, asked: Which) -> str:
    """Return why no record in a store matches the query."""
    from cadcam.record.store import NAMED
    from cadcam.report.table import counted

    for name in NAMED:
        value = asked[name]
        known = store.values(name) - {""} if value is not None else set()
        if value is not None and value not in known:
            return str(UnknownName(name, value, known))
    options = {"sha256": "source"}
    given = ", ".join(f"--{options.get(name, name)}" for name, value in asked.items() if value is not None)
    return f"no record fits {given} ({counted(store.count(), 'record')} in all)" if given else "holds no records"


def _there(arguments: argparse.Namespace) -> Store:
    """Return the store, which must exist."""
    from cadcam.record.store import open_store

    return open_store(store_address(arguments), create=False)


def run_list(arguments: argparse.Namespace) -> None:
    """Print the latest records."""
    from cadcam.report.state.tables import list_table

    _check_newest(arguments)
    asked = _asked(arguments)
    with _there(arguments) as store:
        shown = store.query(**asked, newest=arguments.newest)
        of = store.count(**asked) if shown else 0
        _say_if_none(store, asked, shown)
    if arguments.json:
        print_json({"records": [_as_json(record) for record in shown], "of": of})
    else:
        print_tables([list_table(shown, of=of)])


def _say_if_none(store: Store, asked: Which, found: Sized) -> None:
    if not found:
        say(f"store {store.name}: {_why_none(store, asked)}")


def _check_newest(arguments: argparse.Namespace) -> None:
    if arguments.newest < 1:
        raise BadValue("--newest", arguments.newest, "1 or more")


def run_show(arguments: argparse.Namespace) -> None:
    """Print a record in full."""
    from cadcam.report.state.tables import record_tables

    if len(arguments.id) < _SHORT_ID:
        listed = f"`cadcam state list` prints it, of one part with --serial {arguments.id}"
        raise BadValue("id", repr(arguments.id), f"{_SHORT_ID} characters of it or more: {listed}")
    with _there(arguments) as store:
        found = store.query(id_begins=arguments.id)
    if len(found) != 1:
        how_many = f"the beginning of {len(found) or 'no'} ids in {store.name}"
        raise BadValue("id", f"{arguments.id!r}, {how_many}", "that of one record, as `cadcam state list` prints it")
    if arguments.json:
        print_json(_as_json(found[0]))
    else:
        print_tables(record_tables(found[0]))


def run_trend(arguments: argparse.Namespace) -> None:
    """Print a feature's deviation over the parts."""
    from cadcam.kinds import expect_known
    from cadcam.record.trend import trend
    from cadcam.report.state.json import trend_as_json
    from cadcam.report.state.tables import trend_tables

    _check_newest(arguments)
    asked = _asked(arguments)
    with _there(arguments) as store:
        stand = store.standing(**asked)  # first: what is added meanwhile then replaces nothing that is read
        records = store.of_feature(arguments.feature, **asked)
        if not records:
            raise UnusableStore(store.name, _why_none(store, asked))
        if not any(record.deviations or record.findings for record in records):
            expect_known(arguments.feature, "feature", store.values("feature"))
    standing = [record for record in records if record.id in stand]
    seen = trend(standing, arguments.feature, kind=arguments.kind, replaced=len(records) - len(standing))
    if arguments.json:
        print_json(trend_as_json(seen))
    else:
        print_tables(trend_tables(seen, newest=arguments.newest))


def run_page(arguments: argparse.Namespace) -> None:
    """Write the page of the latest records."""
    from cadcam.record.trend import standing
    from cadcam.report.state.page import write_state_page
    from cadcam.report.table import counted

    check_target(arguments.output, (".html",))
    _check_newest(arguments)
    asked = _asked(arguments)
    with _there(arguments) as store:
        records = store.query(**asked, newest=arguments.newest)
        if not records:
            raise UnusableStore(store.name, _why_none(store, asked))
        of = store.count(**asked)
    write_state_page(arguments.output, records)
    if arguments.json:
        print_json({"output": arguments.output, "records": len(records), "of": of})
    else:
        latest = f", the latest of {of}" if of > len(records) else ""
        left = len(records) - len(standing(records))
        less = f", {left} left out (later ones of the same parts count)," if left else ""
        say(f"wrote {counted(len(records), 'record')}{latest}{less} to {arguments.output}")


def run_export(arguments: argparse.Namespace) -> None:
    """Write records to a file."""
    from cadcam.record.export import SUFFIXES, write_records
    from cadcam.report.table import counted

    check_target(arguments.output, SUFFIXES)
    asked = _asked(arguments)
    with _there(arguments) as store:
        records = store.select(**asked)
        _say_if_none(store, asked, records)
        write_records(arguments.output, records)
    if arguments.json:
        print_json({"output": arguments.output, "records": len(records)})
    else:
        say(f"wrote {counted(len(records), 'record')} to {arguments.output}")


def _asked(arguments: argparse.Namespace) -> Which:
    """Return the arguments for `Store.query`."""
    from hashlib import sha256

    from cadcam.files.text import read_bytes

    since = None if arguments.since is None else arguments.since[0]
    until = None if arguments.until is None else arguments.until[1]
    if since and until and since > until:
        raise BadValue("--since", f"{since:%Y-%m-%d %H:%M}, after --until", "a time before it")
    return {
        "part": arguments.part,
        "serial": arguments.serial,
        "station": arguments.station,
        "verdict": arguments.verdict,
        "since": since,
        "until": until,
        "sha256": None if arguments.source is None else sha256(read_bytes(arguments.source)).hexdigest(),
    }


def _as_json(record: Record) -> dict[str, Any]:
    from cadcam.record.export import record_as_json

    return record_as_json(record)


def _when(text: str) -> tuple[datetime, datetime]:
    """Return first and last moment of a day, or the same moment twice for a time."""
    with suppress(ValueError):
        day = datetime.combine(date.fromisoformat(text), time.min, UTC)
        return day, datetime.combine(day, time.max, UTC)
    try:
        moment = datetime.fromisoformat(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not a time; give 2026-03-01 or 2026-03-01T14:30") from None
    moment = moment if moment.tzinfo else moment.replace(tzinfo=UTC)
    return moment, moment
