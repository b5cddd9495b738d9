"""What `cadcam inspect` prints: of each part as it is judged, and of all of them at the end."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from cadcam.cli.arguments import NO
from cadcam.cli.output import print_json, print_json_line, print_tables, say

if TYPE_CHECKING:
    from cadcam.record.record import Record


class Telling:
    """The parts so far, of one that was photographed anew what was found last.

    json: they are printed as JSON, in one document at the end; lines: in one line each, when it is known. incomplete:
    what the parts lack, by serial number, of which at the end not every camera has one photo.
    """

    def __init__(self, *, json: bool, lines: bool) -> None:
        self._json, self._lines = json, json and lines
        self._parts: dict[str, dict[str, Any]] = {}
        self._errors: dict[str, str] = {}
        self.incomplete: dict[str, str] = {}

    def begin(self, serial: str) -> None:
        """Forget why a part could not be judged, if so: it is looked at anew."""
        self._errors.pop(serial, None)

    def judged(self, record: Record, number: str, took_s: float | None) -> None:
        """Tell what was found of a part; took_s: None of one that was judged before."""
        said = {name: getattr(record, name) for name in ("serial", "id", "verdict", "reason", "quality")}
        said |= {"found": record.pose is not None, "judged_before": took_s is None}
        self._parts[record.serial] = said
        if self._lines:
            print_json_line(said)
        elif not self._json and took_s is not None:
            _print(record, number, took_s)

    def failed(self, serial: str, error: str) -> None:
        """Tell why a part could not be judged."""
        self._errors[serial] = error
        self._aside(serial, "error", error)

    def waits(self, serial: str, why: str) -> None:
        """Tell what a part lacks to be judged."""
        self._aside(serial, "incomplete", why)

    def _aside(self, serial: str, what: str, why: str) -> None:
        if self._lines:
            print_json_line({"serial": serial, what: why})
        say(f"{serial}: {why}")

    def end(self, latest: Sequence[Record], store: str) -> None:
        """Tell what all parts come to."""
        from cadcam.report.state.tables import features_table

        if self._json and not self._lines:
            more = {"errors": self._errors, "incomplete": list(self.incomplete), "store": store}
            print_json({"parts": list(self._parts.values())} | more)
            return
        if latest and not self._json:
            print_tables([features_table(sorted(latest, key=lambda record: record.time))])
        say(self._sum(store))

    def _sum(self, store: str) -> str:
        from cadcam.report.table import counted

        counts = Counter(part["verdict"] or "not judged" for part in self._parts.values())
        said = [f"{count} {verdict}" for verdict, count in counts.items()]
        said += [f"{len(self._errors)} could not be judged"] if self._errors else []
        if self.incomplete:
            first = next(iter(self.incomplete))
            said.append(f"{len(self.incomplete)} without a photo of each camera, or with several ({first} ...)")
        known = sum(part["judged_before"] for part in self._parts.values())
        before = f" ({known} judged before)" if known else ""
        parts = counted(len(self._parts.keys() | self._errors.keys()), "part")
        return ": ".join([f"{parts}{before}", *([", ".join(said)] if said else [])]) + f"; kept in {store}"

    @property
    def errors(self) -> dict[str, str]:
        """Why parts could not be judged, by serial number."""
        return self._errors

    @property
    def exit_code(self) -> int:
        """What the parts come to."""
        if self._errors or self.incomplete:
            return 2
        verdicts = {part["verdict"] for part in self._parts.values()}
        if "FAIL" in verdicts:
            return 1
        return 0 if verdicts <= {"PASS", ""} and all(part["found"] for part in self._parts.values()) else NO


def _print(record: Record, number: str, took_s: float) -> None:
    from cadcam.report.state.tables import unjudged
    from cadcam.report.table import spelled

    what = f"{record.verdict or unjudged(record):<9}  {took_s:5.1f} s  {spelled(record.reason)}"
    print(f"{number:>9}  {spelled(record.serial):<12}  {what}".rstrip(), flush=True)
