"""One option, one meaning: across verbs a name keeps its kind of value and its default, or the reason stands here."""

from __future__ import annotations

import argparse
import inspect
import re
from collections import defaultdict
from collections.abc import Iterable, Iterator
from contextlib import suppress
from pathlib import Path

import pytest

import cadcam
from cadcam.cli import main as cli
from cadcam.cli.arguments import Parser, real

# Options of a verb that take another kind of value than elsewhere, and why.
KINDS = {
    ("--camera", "rig"): "what becomes a camera: there is no camera file yet, only its pictures or points",
    ("--list", "verify"): "what can be listed has parts there: --list PART",
    ("-o", "dataset"): "a data set is a folder",
    ("--output", "dataset"): "a data set is a folder",
}
# Defaults that differ although the value means the same, and why.
DEFAULTS = {
    "--color-by": "lines that are looked at by themselves are told apart by kind; over a photo one colour is clearer",
    "--least-score": "a fitted mark and a correlated window have scores of different scales",
    "--method": "each verb has methods of its own",
    "--output": "several reports at once are a list",
    "--camera": "one camera or several: several are a list",
    "--camera-name": "one camera or several: several are a list",
    "--internals": "one camera or several: several are a list",
    "--reach": "how far a rough pose is off, beside how far a feature may be displaced",
    "--count": "how many there are is not known beforehand, but for the peaks that are listed",
    "--sigma": "a simulation needs one; estimates find it",
    "--survey-sigma": "a simulation needs one; estimates find it",
    "--seen-from": "a plan file may say it",
    "--newest": "a page of charts holds more parts than a screen does",
}
ROOT = Path(__file__).resolve().parents[2]
PAGES = (ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md")))
FOREIGN = {"--python"}  # options of other programs that our messages name: Blender's
# Names of more than one spelling that are written the British way, in names joined by _, -, or a capital.
BRITISH = re.compile(
    r"colour|centre|(?<![a-z])grey|(?<![a-z])(milli)?metres?(?![a-z])|neighbour|behaviour|licence|catalogue|artefact"
    r"|modell|labell|(?<![a-z])(?!pre|noi|rai|pro|exer|other)[a-z]{3,}is(e|ed|er|es|ing|ation)(?![a-z])",
    re.IGNORECASE,
)
UNITS = re.compile(r"-(mm|cm|um|m|px|deg|rad|percent|s)$")


def options(top: argparse.ArgumentParser) -> Iterator[tuple[str, argparse.Action]]:
    """Yield every argument of every verb and job, with the words that lead there."""

    def below(parser: argparse.ArgumentParser, words: str) -> Iterator[tuple[str, argparse.Action]]:
        for action in parser._actions:
            if isinstance(action, argparse._SubParsersAction):
                for name, verb in action.choices.items():
                    yield from below(verb, f"{words} {name}".strip())
            elif not isinstance(action, (argparse._HelpAction, argparse._VersionAction)):
                yield words, action

    yield from below(top, "")


def kind(action: argparse.Action) -> str:
    """Return what an option takes, in words: its metavar without NAME= or VIEW=, how many, or that it is a switch."""
    if action.nargs == 0:
        return "switch"
    if action.choices is not None:
        return "choice"
    metavar = str(action.metavar).rpartition("=")[2] if action.metavar != "NAME=VALUE" else "NAME=VALUE"
    return metavar + {"+": " ...", "?": "?"}.get(str(action.nargs), "")


def clashes(top: argparse.ArgumentParser) -> list[str]:
    """Return the options that take one kind of value here and another there."""
    kinds: dict[str, dict[str, list[str]]] = defaultdict(lambda: defaultdict(list))
    for verb, action in options(top):
        for name in action.option_strings:
            if (name, verb) not in KINDS:
                kinds[name][kind(action)].append(verb)
    return [f"{name}: {dict(said)}" for name, said in kinds.items() if len(said) > 1]


def test_an_option_takes_the_same_kind_of_value_in_every_verb() -> None:
    assert clashes(cli.parser()) == []


def test_an_option_means_the_same_where_it_is_left_out() -> None:
    """Exactly the exceptions above differ: one that is no longer needed goes."""
    usual: dict[str, set[str]] = defaultdict(set)
    for _, action in options(cli.parser()):
        for name in action.option_strings[-1:]:
            usual[name].add("" if action.default in (None, False) else repr(action.default))
    assert {name for name, said in usual.items() if len(said) > 1} == set(DEFAULTS)


def test_every_exception_is_still_one(monkeypatch: pytest.MonkeyPatch) -> None:
    excepted = {name for name, _ in KINDS}
    monkeypatch.setattr(f"{__name__}.KINDS", {})
    assert {clash.partition(":")[0] for clash in clashes(cli.parser())} == excepted


def test_the_check_of_names_can_fail() -> None:
    top = Parser()
    verbs = top.add_subparsers()
    verbs.add_parser("render").add_argument("--lens", metavar="MM")
    verbs.add_parser("calibrate").add_argument("--lens", metavar="MODEL:TERMS")
    assert clashes(top) == ["--lens: {'MM': ['render'], 'MODEL:TERMS': ['calibrate']}"]


@pytest.mark.parametrize(
    ("verb", "action"), list(options(cli.parser())), ids=lambda v: v if isinstance(v, str) else v.dest
)
def test_every_argument_says_what_it_takes_and_what_for(verb: str, action: argparse.Action) -> None:
    assert action.help
    assert all(not UNITS.search(name) for name in action.option_strings), "the unit stands in the metavar or the help"
    if not action.option_strings:
        assert str(action.metavar).isupper(), "what stands without an option is in capitals, as in -o FILE"
    if action.option_strings and action.nargs != 0 and action.choices is None:
        assert action.metavar
        assert str(action.metavar) == str(action.metavar).strip()
    if action.type is real and action.metavar == "N":
        assert "number" in action.help or "aperture" in action.help, f"{verb}: of which unit?"


def test_what_a_verb_writes_is_always_behind_an_option() -> None:
    """Where the output stands need not be remembered by verb; IN OUT is convert's alone."""
    outputs = {(verb, *action.option_strings) for verb, action in options(cli.parser()) if action.dest == "output"}
    assert {words for words in outputs if words[1:] != ("-o", "--output")} == {("convert",)}


def test_an_option_is_spelled_out(capsys: pytest.CaptureFixture[str]) -> None:
    """Half a name would be another option's beginning one day: scripts must not depend on what there is not yet."""
    for words, meant in (
        (["lens", "--sensor", "1/2"], "--sensor-size"),
        (["verify", "--toleranc", "t.yaml"], "--tolerances"),
    ):
        with pytest.raises(SystemExit):
            cli.main(words)
        assert f"did you mean {meant}?" in capsys.readouterr().err


def unknown(text: str) -> list[str]:
    """Return the options in the commands of a text that their verb does not have, each with its command."""
    known: dict[str, set[str]] = defaultdict(lambda: {"--help", "-h"})
    for verb, action in options(cli.parser()):
        known[verb].update(action.option_strings)
    wrong = []
    for verb, job, rest in re.findall(r"\bcadcam ([a-z]+)( [a-z]+)?([^`\n|#]*)", text.replace("\\\n", " ")):
        words = f"{verb}{job}" if f"{verb}{job}" in known else verb
        if words in known:
            used = re.findall(r"(?<![\w-])--?[a-z][a-z-]*", re.sub("'[^']*'", "", rest))
            wrong += [f"cadcam {words} {option}" for option in used if option not in known[words]]
    return wrong


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_documents_use_options_that_there_are(page: Path) -> None:
    assert unknown(page.read_text()) == []


def test_a_document_with_an_option_of_another_verb_is_found() -> None:
    assert unknown("`cadcam lens --sensor 1/2`, `cadcam station map a.json \\\n  --csv x`, `cadcam render a -o b`") == [
        "cadcam lens --sensor",
        "cadcam station map --csv",
    ]


def test_messages_and_help_name_options_that_there_are() -> None:
    there = {name for _, action in options(cli.parser()) for name in action.option_strings}
    there |= {"--help", "--version"}
    ours = Path(cadcam.__file__).parent
    for file in sorted(ours.rglob("*.py")):
        text = file.read_text()
        of_styles = set(re.findall(r"var\((--[a-z-]+)\)", text))
        named = set(re.findall(r"(?<![\w-])--[a-z][a-z-]*[a-z]\b", text)) - of_styles - FOREIGN
        assert named <= there, f"{file.relative_to(ours)}: {named - there}"


def test_help_of_an_option_breaks_no_name_at_its_hyphen(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    with pytest.raises(SystemExit):
        cli.main(["targets", "find", "--help"])
    assert "dot-ring:4cm:8cm:12cm" in capsys.readouterr().out.partition("examples:")[0]


def public_names() -> Iterator[str]:
    """Yield every public name of cadcam, the members of its classes, and the parameters of all."""
    for name in cadcam.__all__:
        thing = getattr(cadcam, name)
        called = {name: thing} if callable(thing) else {}
        yield name
        if inspect.isclass(thing):
            members = {member for member in dir(thing) if not member.startswith("_")}
            members |= set(getattr(thing, "__dataclass_fields__", ()))
            yield from (f"{name}.{member}" for member in members)
            called |= {f"{name}.{member}": getattr(thing, member, None) for member in members}
        for words, function in called.items():
            if callable(function):
                try:
                    parameters = inspect.signature(function).parameters
                except ValueError:  # of what is written in C, which does not say
                    continue
                yield from (f"{words}({parameter})" for parameter in parameters)


def british(names: Iterable[str]) -> list[str]:
    """Return the names with a word that is spelled the British way; a capital begins a word."""
    return [name for name in names if BRITISH.search(re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name))]


def test_names_are_spelled_the_american_way() -> None:
    """What a user types has one spelling, in options, in what they can be set to, and in Python."""
    typed = [name for _, action in options(cli.parser()) for name in action.option_strings or (action.dest,)]
    typed += [str(choice) for _, action in options(cli.parser()) for choice in action.choices or ()]
    assert british(typed) == []
    assert british(public_names()) == []


def test_a_british_name_is_found() -> None:
    wrong = ["--centre-jitter", "--linearise", "LineStyle.colour", "Camera.normalised", "to_grey", "Quantisation"]
    assert british([*wrong, "--center-jitter", "raised", "noise", "Noise", "precise", "sized", "diameter"]) == wrong


def test_help_shows_no_default_by_its_address() -> None:
    for name in cadcam.__all__:
        thing = getattr(cadcam, name)
        members = {f"{name}.{m}": getattr(thing, m) for m in vars(thing)} if isinstance(thing, type) else {}
        for words, function in ({name: thing} | members).items():
            if callable(function):
                with suppress(ValueError):  # of what is written in C, which does not say
                    assert " at 0x" not in str(inspect.signature(function)), words
