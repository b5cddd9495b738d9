"""A worker process: reads its job, then shots, from its standard input, and writes the files of each to its output.

`dataset.processes` starts it. It ends when its input ends, so that it never outlives its parent.
"""

from __future__ import annotations

import os
import pickle
import sys
import traceback
from contextlib import suppress
from dataclasses import dataclass
from typing import TypeAlias

from cadcam.dataset.layout import DatasetFiles
from cadcam.dataset.record import files_of
from cadcam.dataset.shot import Shot
from cadcam.dataset.view_renderer import ViewInputs, ViewRenderer
from cadcam.errors import CadcamError
from cadcam.render.lines.seen import Drawable

Files: TypeAlias = dict[str, bytes]  # content by path, the record of the view last


@dataclass(frozen=True, slots=True, eq=False)
class Job:
    """What a worker needs of a data set; edges: the scene's, prepared for all views."""

    inputs: ViewInputs
    edges: Drawable
    layout: DatasetFiles


@dataclass(frozen=True, slots=True, eq=False)
class Task:
    """A view to make; `photo` is the content of its background's file."""

    shot: Shot
    photo: bytes | None = None


@dataclass(frozen=True, slots=True)
class Bug:
    """A bug of ours in a worker, with its traceback."""

    text: str


Answer: TypeAlias = Files | CadcamError | Bug


class Maker:
    """Makes the files of one view after the other; one thread at a time."""

    def __init__(self, job: Job) -> None:
        self._job, self._renderer = job, ViewRenderer(job.inputs, job.edges)

    def files(self, task: Task) -> Files:
        """Return the content of the view's files by path, its record last."""
        return files_of(self._renderer.view(task.shot, task.photo), self._job.inputs, self._job.layout)

    def answer(self, task: Task) -> Answer:
        """Return the files, or the error: for another process to read."""
        try:
            return self.files(task)
        except CadcamError as error:
            return error
        except Exception:
            return Bug(traceback.format_exc())


def files_in(answer: Answer) -> Files:
    """Return the files in an answer, or raise the error in it."""
    if isinstance(answer, CadcamError):
        raise answer
    if isinstance(answer, Bug):
        raise RuntimeError(f"in a worker:\n{answer.text}")
    return answer


def main() -> None:
    """Work until the input ends."""
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # anything printed goes to stderr
    requests = sys.stdin.buffer
    with suppress(EOFError, BrokenPipeError):
        maker = Maker(pickle.load(requests))
        while True:
            answers.write(pickle.dumps(maker.answer(pickle.load(requests)), protocol=pickle.HIGHEST_PROTOCOL))
            answers.flush()
