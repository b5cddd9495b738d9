"""The job's folder, and a way to run a command line as a user does."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from cadcam.cli.main import main

from .cell import make_line
from .job import Ran, make_job
from .locating import make_photo_job


@pytest.fixture(autouse=True)
def _cache_of_its_own(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    """Keep nothing in the user's own folders."""
    monkeypatch.setenv("CADCAM_CACHE", str(tmp_path_factory.getbasetemp() / "cache"))


@pytest.fixture
def cadcam(capsys: pytest.CaptureFixture[str]) -> Callable[..., Ran]:
    """Return a function that runs a command line in this process."""

    def run(*words: str | Path) -> Ran:
        capsys.readouterr()
        code = main([str(word) for word in words])
        said = capsys.readouterr()
        return Ran(code, said.out, said.err)

    return run


@pytest.fixture
def job(tmp_path: Path) -> Path:
    """Return a folder with the job's files."""
    make_job(tmp_path)
    return tmp_path


@pytest.fixture
def unread(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nobody reads the tables, as of `cadcam ... | head -3`: printing them fails."""

    def gone(*_: object) -> None:
        raise RuntimeError

    monkeypatch.setattr("cadcam.report.table.show", gone)


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a folder with the photo, the camera and a rough start, and the working folder."""
    monkeypatch.chdir(tmp_path)
    make_photo_job(tmp_path)
    return tmp_path


@pytest.fixture
def cell(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the folder of a line: see `make_line`."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("CADCAM_STORE", raising=False)
    make_line(tmp_path)
    return tmp_path
