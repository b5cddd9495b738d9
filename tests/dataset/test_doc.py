"""What docs/datasets.md shows runs as it stands there."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from cadcam.cad.parts import machined_bracket
from cadcam.cad.write import write_model
from cadcam.cli.main import main
from cadcam.dataset.plan_file import KEYS, read_plan

DOCUMENT = (Path(__file__).resolve().parents[2] / "docs/datasets.md").read_text()


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    write_model(tmp_path / "part.stl", machined_bracket())
    monkeypatch.chdir(tmp_path)
    return tmp_path


def block(marker: str, kind: str) -> str:
    found = re.search(rf"{marker}```{kind}\n(.*?)```", DOCUMENT, flags=re.DOTALL)
    assert found is not None
    return found[1]


def test_the_first_command_makes_the_files_of_the_table(here: Path) -> None:
    words = shlex.split(block("<!-- command: first data set -->\n", "sh"))
    assert main([*words[1:], "--size", "160x120"]) == 0
    for name in ("rgb/000000.png", "depth/000000.png", "normal/000000.png", "edges/000000.npz", "view/000000.json"):
        assert (here / "set/train/000000" / name).exists()
    assert (here / "set/contact.png").exists()


def test_the_plan_is_read_and_every_key_is_told(here: Path) -> None:
    text = block("<!-- plan -->\n", "yaml")
    (here / "plan.yaml").write_text(text)
    assert read_plan("plan.yaml").views == 1000
    assert [key for key in KEYS if key not in DOCUMENT] == []


def test_the_python_runs(here: Path) -> None:
    (here / "made.py").write_text(block("## In Python\n\n", "python"))
    ran = subprocess.run([sys.executable, "-W", "error", "made.py"], capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stderr
    assert "contact.png" in ran.stdout
