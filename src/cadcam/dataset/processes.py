"""Views made by processes on this machine. One that dies is replaced, and its view is made again."""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from itertools import islice
from queue import SimpleQueue
from threading import Thread
from typing import Any, TypeAlias

from cadcam.dataset.worker import Answer, Files, Job, Task, files_in
from cadcam.errors import WorkerDied

_TRIES = 3  # processes that may die over one view
_AHEAD = 2  # views given to a worker: the next one waits in its pipe
_PIPE_BYTES = 1 << 20  # so that all files of a view fit, and no worker waits until its pipe is read
# not -m: as __main__ the module would have a second copy of the classes that its input consists of
_COMMAND = (sys.executable, "-P", "-c", "from cadcam.dataset.worker import main; main()")
# One thread per process: the processes are the parallelism, and sums in matrix products depend on the thread count.
_ENVIRONMENT = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
# glibc's malloc on huge pages: TLB misses were some 4 % of a view's time. Other C libraries ignore this, and a user's
# own setting takes precedence.
_HUGE_PAGES = {"GLIBC_TUNABLES": "glibc.malloc.hugetlb=1"}

_Answers: TypeAlias = "SimpleQueue[tuple[_Worker, Answer | None]]"


def on_processes(job: Callable[[], Job], tasks: Iterable[Task], workers: int) -> Iterator[Files]:
    """Yield the files of each task as they arrive, in any order, made by `workers` processes.

    job: requested while the processes start. Raises the `CadcamError` that a task ended with, and `WorkerDied` where
    process after process died over one.
    """
    answers: _Answers = SimpleQueue()
    crew: list[_Worker] = []
    try:
        crew.extend(_Worker(answers) for _ in range(workers))
        yield from _made(crew, answers, _pickled(job()), iter(tasks))
    finally:
        for worker in crew:
            worker.end()


def _made(crew: list[_Worker], answers: _Answers, job: bytes, tasks: Iterator[Task]) -> Iterator[Files]:
    for worker in crew:
        worker.tell(job)
    for _ in range(_AHEAD):
        for worker in crew:
            worker.take(tasks)
    while any(worker.under_way for worker in crew):
        worker, answer = answers.get()
        if answer is None:
            worker.replace()
        else:
            worker.answered()
            worker.take(tasks)
            yield files_in(answer)


class _Worker:
    """A process, replaced when it dies by another, which is sent everything still unanswered."""

    def __init__(self, answers: _Answers) -> None:
        self.under_way: deque[Task] = deque()
        self._answers, self._job, self._died = answers, b"", 0
        self._process = self._started()

    def _started(self) -> _Process:
        return _Process(lambda answer: self._answers.put((self, answer)))

    def tell(self, job: bytes) -> None:
        """Send the process the job that its tasks belong to."""
        self._job = job
        self._process.send(job)

    def take(self, tasks: Iterator[Task]) -> None:
        """Accept the next of the tasks, if there is one."""
        for task in islice(tasks, 1):
            self.under_way.append(task)
            self._process.send(_pickled(task))

    def answered(self) -> None:
        """Remove the task that was accepted first."""
        self._died = 0
        self.under_way.popleft()

    def replace(self) -> None:
        """Start another process instead of one that died. Raises `WorkerDied` once too many died over a view."""
        code = self._process.end()
        self._died += 1
        if not self.under_way:
            return
        if self._died == _TRIES:
            raise WorkerDied(
                f"view {self.under_way[0].shot.index}: {_TRIES} processes one after the other died over it (the last "
                f"with {code}); if memory was short, try fewer --workers; what is done is kept"
            )
        self._process = self._started()
        for message in (self._job, *map(_pickled, self.under_way)):
            self._process.send(message)

    def end(self) -> None:
        """End the process: its current work is not needed."""
        self._process.kill()
        self._process.end()


class _Process:
    """A process, with two threads for input and output: no other thread waits for its pipes.

    hear: called with each answer, and finally, when no more can come, with None.
    """

    def __init__(self, hear: Callable[[Answer | None], None]) -> None:
        self._messages: SimpleQueue[bytes | None] = SimpleQueue()
        self._process = _start()
        self._threads = [
            Thread(target=self._write, daemon=True),  # not waited for if Ctrl-C comes as they start
            Thread(target=self._read, args=(hear,), daemon=True),
        ]
        for thread in self._threads:
            thread.start()

    def send(self, message: bytes) -> None:
        """Send a pickled message after those before it; no effect if the process died."""
        self._messages.put(message)

    def _write(self) -> None:
        pipe = self._process.stdin
        with suppress(OSError):
            while pipe and (message := self._messages.get()) is not None:
                pipe.write(message)
                pipe.flush()

    def _read(self, hear: Callable[[Answer | None], None]) -> None:
        pipe = self._process.stdout
        with suppress(OSError, EOFError, pickle.UnpicklingError):  # it ended, perhaps within an answer
            while pipe:
                hear(pickle.load(pipe))
        hear(None)

    def kill(self) -> None:
        """Terminate it."""
        self._process.kill()

    def end(self) -> int:
        """Wait for its end, close its pipes with their unread contents, and return how it ended."""
        code = self._process.wait()
        self._messages.put(None)
        for thread in self._threads:
            thread.join()
        for pipe in (self._process.stdin, self._process.stdout):
            with suppress(OSError):
                if pipe is not None:
                    pipe.close()
        return code


def _start() -> subprocess.Popen[bytes]:
    environment = {**_HUGE_PAGES, **os.environ, **_ENVIRONMENT}
    how: dict[str, Any] = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "env": environment}
    process = subprocess.Popen(_COMMAND, start_new_session=True, **how)  # Ctrl-C is for the parent process
    with suppress(ImportError, AttributeError, OSError):  # not on every system, and not for every user
        import fcntl

        fcntl.fcntl(process.stdout or 0, fcntl.F_SETPIPE_SZ, _PIPE_BYTES)
    return process


def _pickled(message: Job | Task) -> bytes:
    return pickle.dumps(message, protocol=pickle.HIGHEST_PROTOCOL)
