"""The command line as a whole: quick help, exit codes, examples that parse."""

from __future__ import annotations

import argparse
import os
import re
import shlex
import subprocess
import sys
import tomllib
from contextlib import suppress
from pathlib import Path
from types import ModuleType

import pytest

import cadcam
from cadcam import __main__ as started
from cadcam.cli import arguments
from cadcam.cli import main as cli
from cadcam.errors import BadValue

HEAVY = ("numpy", "scipy", "PIL", "embreex", "rich", "cascadio")
VERBS = tuple(verb.__name__.rpartition(".")[2] for verb in cli.VERBS)


def loaded_after(code: str) -> set[str]:
    """Return which heavy packages a fresh interpreter has imported after `code`."""
    tail = f"import sys; print('loaded:', *[m for m in {HEAVY!r} if m in sys.modules])"
    result = subprocess.run([sys.executable, "-c", f"{code}\n{tail}"], capture_output=True, text=True, check=True)
    return set(result.stdout.split("loaded:")[1].split())


def help_of(verb: str) -> str:
    return f"from cadcam.cli.main import main\ntry: main([{verb!r}, '--help'])\nexcept SystemExit: pass"


def test_importing_cadcam_imports_nothing_heavy() -> None:
    assert loaded_after("import cadcam") == set()


def test_help_of_any_verb_imports_nothing_heavy() -> None:
    assert loaded_after("\n".join(help_of(verb) for verb in VERBS)) == set()


def test_the_check_for_heavy_imports_can_fail() -> None:
    assert "numpy" in loaded_after("import cadcam; cadcam.Camera")


@pytest.mark.parametrize("verb", VERBS)
def test_every_example_in_a_help_text_is_accepted(verb: str) -> None:
    parser = cli.parser()
    action = next(a for a in parser._actions if isinstance(a, argparse._SubParsersAction))
    lines = (action.choices[verb].epilog or "").splitlines() + (parser.epilog or "").splitlines()
    for actions in (a for a in action.choices[verb]._actions if isinstance(a, argparse._SubParsersAction)):
        lines += [line for part in actions.choices.values() for line in (part.epilog or "").splitlines()]
    commands = [re.split(r"\s{3,}", line.strip())[0] for line in lines if line.strip().startswith(f"cadcam {verb}")]
    assert len(commands) >= 2
    for command in commands:
        assert parser.parse_args(shlex.split(command)[1:]).verb == verb


def test_the_parser_of_one_verb_is_that_among_all() -> None:
    """Where a verb's module had another name, all would be built, as for a word that is no verb."""

    def helps(*asked: str) -> dict[str, str]:
        (choices,) = (a.choices for a in cli.parser(*asked)._actions if isinstance(a, argparse._SubParsersAction))
        return {verb: one.format_help() for verb, one in choices.items()}

    every = helps()
    assert tuple(every) == VERBS
    assert [helps(verb) for verb in VERBS] == [{verb: text} for verb, text in every.items()]
    assert helps("nonsense") == every


@pytest.mark.parametrize("odd", ["Gehäuse", os.fsdecode(b"Geh\xe4use")])
def test_names_that_stdout_has_no_characters_for_are_spelled_out_but_json_is_utf_8(job: Path, odd: str) -> None:
    try:
        model = (job / "block.obj").rename(job / f"{odd}.obj")
    except OSError:
        pytest.skip("this disk takes no such names")
    model.write_text(f"o Käfig\n{model.read_text()}")
    for flag, said in (((), rb"K\xe4fig"), (("--json",), "Käfig".encode())):
        command = [sys.executable, "-m", "cadcam", "verify", str(model), "--list", *flag]
        ran = subprocess.run(command, capture_output=True, env={**os.environ, "PYTHONIOENCODING": "ascii"}, check=False)
        assert ran.returncode == 0, ran.stderr
        assert said in ran.stdout


def test_version_is_the_packages(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stopped:
        cli.main(["--version"])
    assert stopped.value.code == 0
    assert capsys.readouterr().out == f"cadcam {cadcam.__version__}\n"


@pytest.mark.parametrize("words", [[], ["kalibrate"], ["calibrate"], ["calibrate", "p.csv", "--size", "768"]])
def test_a_wrong_command_line_is_exit_2(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stopped:
        cli.main(words)
    assert stopped.value.code == 2
    said = capsys.readouterr().err
    assert said.startswith("cadcam")
    assert said.endswith(" --help\n")
    assert said.count("\n") == 1


def _numeric() -> list[tuple[str, str]]:
    """Every option of every verb that takes one number, as (command, option)."""
    found: list[tuple[str, str]] = []

    def look(parser: argparse.ArgumentParser, words: tuple[str, ...]) -> None:
        for action in parser._actions:
            if isinstance(action, argparse._SubParsersAction):
                for name, below in action.choices.items():
                    look(below, (*words, name))
            elif action.type in NUMBERS and action.nargs is None:
                found.append((" ".join(words), action.option_strings[-1]))

    look(cli.parser(), ())
    return found


NUMBERS = (float, int, arguments.real, arguments.whole, arguments.seed)


@pytest.mark.parametrize(("verb", "option"), _numeric())
def test_a_number_that_none_can_mean_is_refused_by_every_option(
    verb: str, option: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Squares of 1e300 overflow, not a number spreads, a billion billion threads never start."""
    for value in ("nan", "inf", "-1e300", "1e300", "1e-300", "99999999999999999999", "a"):
        with pytest.raises(SystemExit) as stopped:
            cli.parser(verb.split()[0]).parse_args([*verb.split(), f"{option}={value}"])
        assert stopped.value.code == 2
        assert re.search(rf"argument (-\w/)?{option}: ", said := capsys.readouterr().err)
        assert f"'{value}' is " in said


@pytest.mark.parametrize(("verb", "option"), _numeric())
def test_a_number_with_a_minus_is_a_value_however_it_is_written(
    verb: str, option: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Without the parser's own rule for negative numbers -1e9 would count as an option left without its value."""
    for value in ("-1e9", "-1,0,0,5", "-.5e3"):
        with suppress(SystemExit):  # for what else the verb needs, or a value out of range
            cli.parser(verb.split()[0]).parse_args([*verb.split(), option, value])
        assert "expected one argument" not in capsys.readouterr().err


def test_numbers_with_a_minus_and_a_comma_are_the_value_of_an_option() -> None:
    assert cli.parser().parse_args(["match", "a.png", "b.png", "--angles", "-1e1,-.5e1"]).angles == (-10.0, -5.0)
    assert cli.parser().parse_args(["measure", "p.csv", "--plane", "-1,0,0,5"]).plane == "-1,0,0,5"


@pytest.mark.parametrize("words", [["doctor"], ["state", "list"], ["targets", "print", "dot:3mm", "-o", "a.svg"]])
def test_an_unknown_option_points_to_the_help_that_lists_the_known_ones(
    words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as stopped:
        cli.main([*words, "--nonsense"])
    assert stopped.value.code == 2
    told = " ".join(("cadcam", *words[: 2 if words[0] != "doctor" else 1]))
    assert capsys.readouterr().err == f"{told}: unrecognized arguments: --nonsense; see {told} --help\n"


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["overaly", "a.png"], "cadcam: unknown verb 'overaly'; did you mean 'overlay'? (known: "),
        (["station"], "arguments are required: one of calibrate, map, measure, recalibrate, report, simulate; see "),
        (["state", "lsit"], "cadcam state: unknown job 'lsit'; did you mean 'list'? (known: "),
        (
            ["render", "a.stl", "-o", "a.png", "--look", "plain"],
            "cadcam render: unknown --look 'plain' (known: default, ",
        ),
        (["doctor", "--jason"], "cadcam doctor: unrecognized arguments: --jason; did you mean --json?; see "),
        (["board", "chessboard:9x6:25mm"], "cadcam board: the following arguments are required: -o/--output; see "),
        (["overlay", "a.png", "a.stl", "--shaded", "1.5"], "'1.5' is not an opacity from 0 (nothing) to 1 (opaque); "),
        (["lens", "--focal", "16mm"], "'16mm' is not a number; give it alone, in the unit that the help names"),
        (["lens", "--focal", "3,5"], "'3,5' is not a number; write a decimal point, not a comma"),
        (["measure", "a.csv", "--between", "A"], "'A' is not two names with a comma between, such as A,B"),
        (["station", "measure", "--station-file", "s.json", "--between", "A,B,C"], "'A,B,C' is not two names with a"),
        (["verify", "a.png", "a.stl", "--alarms", "1%"], "'1%' is not a share between 0 and 1, such as 0.01 for 1 %"),
    ],
)
def test_a_slip_is_told_the_nearest_that_there_is(
    words: list[str], says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as stopped:
        cli.main(words)
    assert stopped.value.code == 2
    assert says in capsys.readouterr().err


def test_without_a_place_for_results_the_work_is_done(tmp_path: Path) -> None:
    """Some services close stdout and stderr before they start a program: Python then has none at all."""
    command = [sys.executable, "-m", "cadcam", "render", "part.off", "--size", "20x10", "-o", "part.png"]
    (tmp_path / "part.off").write_text("OFF\n4 4 0\n0 0 0\n9 0 0\n0 9 0\n0 0 9\n3 0 2 1\n3 0 1 3\n3 1 2 3\n3 0 3 2\n")
    quoted = " ".join(shlex.quote(word) for word in command)
    assert subprocess.run(["sh", "-c", f"{quoted} >&- 2>&-"], cwd=tmp_path, check=False).returncode == 0
    assert (tmp_path / "part.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("raised", "code", "traced"),
    [
        (BadValue("size", 0, "more"), 2, False),
        (MemoryError("8 TiB"), 2, False),
        (KeyboardInterrupt(), 130, False),
        (ZeroDivisionError("oops"), 70, True),
    ],
)
def test_exit_codes_tell_what_happened(
    raised: BaseException,
    code: int,
    traced: bool,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def fail(_: argparse.Namespace) -> None:
        raise raised

    monkeypatch.setattr("cadcam.cli.verbs.decompose.run", fail)
    assert cli.main(["decompose", "x.json"]) == code
    said = capsys.readouterr()
    assert said.out == ""
    assert "cadcam decompose: " in said.err
    assert ("Traceback" in said.err) == traced


def test_an_interruption_while_the_command_line_is_loaded_is_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Ctrl-C within the first tenths of a second."""

    class Loading(ModuleType):
        def __getattr__(self, name: str) -> object:
            raise KeyboardInterrupt

    monkeypatch.setitem(sys.modules, "cadcam.cli.main", Loading("cadcam.cli.main"))
    assert started.main() == 130
    assert capsys.readouterr().err == "cadcam: interrupted\n"
    project = tomllib.loads((Path(__file__).resolve().parents[2] / "pyproject.toml").read_text())
    assert project["project"]["scripts"]["cadcam"] == f"{started.__name__}:main"


def test_a_reader_that_stops_early_is_no_error() -> None:
    command = f"{shlex.quote(sys.executable)} -m cadcam --help | head -n 1; exit ${{PIPESTATUS[0]}}"
    result = subprocess.run(["bash", "-c", command], capture_output=True, text=True, check=False)
    assert result.returncode == 0
    assert result.stderr == ""


def test_the_help_of_a_job_shows_examples_or_where_they_are(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    for job, said in (("state add", "cadcam state --help"), ("targets find", "examples:\n")):
        with pytest.raises(SystemExit):
            cli.main([*job.split(), "--help"])
        assert said in capsys.readouterr().out.rpartition("options:")[2]


def test_results_that_nobody_reads_are_not_taken_for_a_yes() -> None:
    """Of `verify` 0 is PASS; a program whose pipe is closed before it has written ends with 141 (128 + SIGPIPE)."""
    into, out = os.pipe()
    os.close(into)
    try:
        command = [sys.executable, "-m", "cadcam", "lens", "--list"]
        ran = subprocess.run(command, stdout=out, stderr=subprocess.PIPE, text=True, check=False)
    finally:
        os.close(out)
    assert (ran.returncode, ran.stderr) == (141, "")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full here")
def test_a_full_disk_behind_stdout_is_said_and_no_bug() -> None:
    command = f"{shlex.quote(sys.executable)} -m cadcam lens --list > /dev/full"
    result = subprocess.run(["bash", "-c", command], capture_output=True, text=True, check=False)
    assert result.returncode == 2
    assert result.stderr == "cadcam lens: stdout cannot be written: No space left on device\n"


@pytest.mark.parametrize("verb", VERBS)
def test_sentences_of_help_fit_a_terminal_of_80_columns(
    verb: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    with pytest.raises(SystemExit):
        cli.main([verb, "--help"])
    narrow = capsys.readouterr().out
    monkeypatch.setenv("COLUMNS", "120")
    with pytest.raises(SystemExit):
        cli.main([verb, "--help"])
    assert "".join(capsys.readouterr().out.split()) == "".join(narrow.split())
    told = [line for line in narrow.splitlines() if not line.startswith(" ") and "  " not in line]
    assert max(map(len, told)) <= 80
