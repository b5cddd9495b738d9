"""The Python of README, python.md and inspect.md runs as printed on the demo's files; README's commands are CI's."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
README = (ROOT / "README.md").read_text()
SNIPPETS = re.findall(r"```python\n(.*?)```", README, flags=re.DOTALL)
PAGE = [
    snippet
    for page in ("docs/python.md", "docs/inspect.md")
    for snippet in re.findall(r"```python\n(.*?)```", (ROOT / page).read_text(), flags=re.DOTALL)
]


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("readme") / "demo"
    subprocess.run([sys.executable, "-m", "cadcam", "demo", str(folder)], check=True, capture_output=True)
    return folder


def test_there_is_a_snippet_for_each_job() -> None:
    assert len(SNIPPETS) == 5
    assert len(PAGE) == 5


@pytest.mark.parametrize("snippet", [*SNIPPETS, *PAGE], ids=range(len(SNIPPETS) + len(PAGE)))
def test_snippet_runs_as_printed(snippet: str, demo: Path) -> None:
    result = subprocess.run(
        [sys.executable, "-W", "error", "-c", snippet], cwd=demo, capture_output=True, text=True, check=False
    )
    assert result.returncode == 0, result.stderr
    assert result.stderr == ""


def test_ci_finds_both_commands() -> None:
    script = (ROOT / ".ci" / "run").read_text()
    for marker in re.findall(r"readme_command '([^']+)'", script):
        assert re.search(rf"<!-- {marker} -->\n```sh\n.+\n```", README)
    assert len(re.findall(r"readme_command '", script)) == 2


def test_every_verb_stands_in_the_readme() -> None:
    from cadcam.cli.main import VERBS

    names = {verb.__name__.rsplit(".", 1)[-1] for verb in VERBS}
    assert {f"`cadcam {name}`" for name in names} <= set(re.findall(r"`cadcam \w+`", README))
