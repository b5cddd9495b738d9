"""`cadcam state`: the measurements of each part, stored, queried, exported."""

from __future__ import annotations

import argparse
import os
from contextlib import suppress
from datetime import UTC, date, datetime, time
from typing import TYPE_CHECKING, Any

from cadcam.cli.arguments import Run, Verbs, add_jobs, add_json, job, verb, whole
from cadcam.cli.output import check_target, print_json, print_tables, say
from cadcam.errors import BadValue, UnknownName, UnusableStore

if TYPE_CHECKING:
    from cadcam.record.record import Record
    from cadcam.record.store import Store, Which

DEFAULT_STORE = "parts.sqlite"
_SHORT_ID = 6
_DESCRIPTION = """\
Keep what was measured of each part: pose, deviations with their uncertainties, verdict, the fingerprints of photo, CAD
and camera, time and station. Records are only added, never changed. Once `add` has said so, a record is on the disk;
several stations may write to one store."""
_EXAMPLES = """\
  cadcam state add verify.json --serial 4711 --station "cell 3"
  cadcam state list --part bracket --verdict FAIL --since 2026-03-01
  cadcam state show 3f2a91c0
  cadcam state trend stiffener --part bracket
  cadcam state export all.csv --store postgresql://user:password@server/yard

the store: --store FILE|URL, else $CADCAM_STORE, else parts.sqlite in this folder. A file is SQLite and needs nothing
else; PostgreSQL needs cadcam[postgresql]. Give a password in $CADCAM_STORE rather than on the command line.

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
    _add_export(jobs)


def _address(arguments: argparse.Namespace) -> str:
    return arguments.store or os.environ.get("CADCAM_STORE", "").strip() or DEFAULT_STORE


def add_store_option(parser: argparse.ArgumentParser) -> None:
    """Add --store."""
    parser.add_argument(
        "--store", metavar="FILE|URL", help=f"SQLite file, or postgresql://... (default $CADCAM_STORE, {DEFAULT_STORE})"
    )


def _job(jobs: Verbs, name: str, run: Run, short: str) -> argparse.ArgumentParser:
    parser = job(jobs, name, run, short=short)
    add_store_option(parser)
    add_json(parser)
    return parser


def _add_add(jobs: Verbs) -> None:
    parser = _job(jobs, "add", run_add, "keep the results in JSON files of `cadcam verify`, or exported records")
    parser.add_argument("files", nargs="+", metavar="FILE", help="JSON of `cadcam verify`, or an export")
    for name, what in (("part", "kind of part"), ("serial", "which one of them"), ("station", "where it was measured")):
        parser.add_argument(f"--{name}", help=f"{what}, in place of what the file says")


def _add_list(jobs: Verbs) -> None:
    parser = _job(jobs, "list", run_list, "list records, the latest at the end")
    _add_filters(parser)
    parser.add_argument("--newest", type=whole, default=30, metavar="N", help="no more than the latest N (default 30)")


def _add_show(jobs: Verbs) -> None:
    parser = _job(jobs, "show", run_show, "show all that one record holds")
    parser.add_argument("id", help=f"the record's id, or its beginning ({_SHORT_ID} characters or more)")


def _add_trend(jobs: Verbs) -> None:
    parser = _job(jobs, "trend", run_trend, "show a feature's deviation over the parts: mean, sigma, verdicts")
    parser.add_argument("feature", help="the feature's name")
    parser.add_argument("--kind", help="which of its deviations, where it has several: position, angle ...")
    _add_filters(parser)


def _add_export(jobs: Verbs) -> None:
    parser = _job(jobs, "export", run_export, "write records to a file")
    parser.add_argument("output", help=".csv (one line per deviation), .json or .jsonl (everything)")
    _add_filters(parser)


def _add_filters(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("which records (default: all)")
    group.add_argument("--part", help="kind of part")
    group.add_argument("--serial", help="which one of them")
    group.add_argument("--station", help="where it was measured")
    verdicts = ("PASS", "FAIL", "UNDECIDED")
    group.add_argument("--verdict", type=str.upper, choices=verdicts, help="as a whole")
    group.add_argument("--since", type=_when, metavar="TIME", help="2026-03-01 or 2026-03-01T14:30, UTC")
    group.add_argument("--until", type=_when, metavar="TIME", help="as --since; a day counts to its end")


def _records(arguments: argparse.Namespace) -> list[Record]:
    from dataclasses import replace

    from cadcam.record.export import read_records

    given = {name: value for name in ("part", "serial", "station") if (value := getattr(arguments, name)) is not None}
    return [replace(record, **given) for file in arguments.files for record in read_records(file)]


def run_add(arguments: argparse.Namespace) -> None:
    """Store records; a new store is created only once the records could be read."""
    from cadcam.record.store import open_store
    from cadcam.report.table import counted

    records = _records(arguments)
    with open_store(_address(arguments)) as store:
        store.add(*records)
    if arguments.json:
        print_json({"store": store.name, "added": [record.id for record in records]})
    else:
        for record in records:
            print(f"{record.id}  {record.part} {record.serial} {record.verdict}".rstrip())
        say(f"{counted(len(records), 'record')} added to {store.name}")


def _asked_for(arguments: argparse.Namespace, *, needed: bool = False) -> list[Record]:
    """Return the records that pass the filters, oldest first; if there are none, the reason is printed, or raised."""
    return _newest(arguments, None, needed=needed)[0]


def _newest(arguments: argparse.Namespace, newest: int | None, *, needed: bool = False) -> tuple[list[Record], int]:
    """Return as many of these records as are asked for, the newest, and the number of all; no more are read."""
    asked = _asked(arguments)
    with _there(arguments) as store:
        records = store.query(**asked, newest=newest)
        if records:
            return records, len(records) if newest is None else store.count(**asked)
        why = _why_none(store, asked)
    if needed:
        raise UnusableStore(store.name, why)
    say(f"store {store.name}: {why}")
    return [], 0


def _why_none(store: Store, asked: Which) -> str:
    """Return why no record in a store matches the query."""
    from cadcam.record.store import NAMED
    from cadcam.report.table import counted

    for name in NAMED:
        value = asked[name]
        known = store.values(name) - {""} if value is not None else set()
        if value is not None and value not in known:
            return str(UnknownName(name, value, known))
    given = ", ".join(f"--{name}" for name, value in asked.items() if value is not None)
    return f"no record fits {given} ({counted(store.count(), 'record')} in all)" if given else "holds no records"


def _there(arguments: argparse.Namespace) -> Store:
    """Return the store, which must exist."""
    from cadcam.record.store import open_store

    return open_store(_address(arguments), create=False)


def run_list(arguments: argparse.Namespace) -> None:
    """Print the latest records."""
    from cadcam.report.state import list_table

    if arguments.newest < 1:
        raise BadValue("--newest", arguments.newest, "1 or more")
    shown, of = _newest(arguments, arguments.newest)
    if arguments.json:
        print_json({"records": [_as_json(record) for record in shown], "of": of})
    else:
        print_tables([list_table(shown, of=of)])


def run_show(arguments: argparse.Namespace) -> None:
    """Print a record in full."""
    from cadcam.report.state import record_tables

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
    from cadcam.record.trend import trend
    from cadcam.report.state import trend_tables

    seen = trend(_asked_for(arguments, needed=True), arguments.feature, kind=arguments.kind)
    if not arguments.json:
        print_tables(trend_tables(seen))
        return
    points = [
        {"time_utc": _as_json(r)["time_utc"], "serial": r.serial, "id": r.id}
        | {f"deviation_{seen.unit}": d.deviation, f"expanded_uncertainty_{seen.unit}": d.expanded_uncertainty}
        for r, d in seen.points
    ]
    said = {"mean": seen.mean, "sigma": seen.sigma if len(seen) > 1 else None, "measured_sigma": seen.measured_sigma}
    counts = {"verdicts": seen.verdicts, "without": [record.id for record in seen.without]}
    numbers = {f"{name}_{seen.unit}": value for name, value in said.items()}
    print_json({"feature": seen.feature, **numbers, **counts, "points": points})


def run_export(arguments: argparse.Namespace) -> None:
    """Write records to a file."""
    from cadcam.record.export import SUFFIXES, write_records
    from cadcam.report.table import counted

    check_target(arguments.output, SUFFIXES)
    records = _asked_for(arguments)
    write_records(arguments.output, records)
    if arguments.json:
        print_json({"output": arguments.output, "records": len(records)})
    else:
        say(f"wrote {counted(len(records), 'record')} to {arguments.output}")


def _asked(arguments: argparse.Namespace) -> Which:
    """Return the arguments for `Store.query`."""
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
