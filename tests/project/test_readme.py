"""The README's commands are CI's, and it names every verb; its Python is run by tests/cli/test_demo.py."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
README = (ROOT / "README.md").read_text()


def test_ci_finds_both_commands() -> None:
    script = (ROOT / ".ci" / "run").read_text()
    for marker in re.findall(r"readme_command '([^']+)'", script):
        assert re.search(rf"<!-- {marker} -->\n```sh\n.+\n```", README)
    assert len(re.findall(r"readme_command '", script)) == 2


def test_every_verb_stands_in_the_readme() -> None:
    from cadcam.cli.main import VERBS

    names = {verb.__name__.rsplit(".", 1)[-1] for verb in VERBS}
    assert {f"`cadcam {name}`" for name in names} <= set(re.findall(r"`cadcam \w+`", README))
