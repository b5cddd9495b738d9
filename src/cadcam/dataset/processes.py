"""Views made on the processes of this machine. One that dies is replaced, and the view it was at is made again."""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
from collections.abc import Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import suppress
from queue import SimpleQueue
from typing import Any

from cadcam.dataset.worker import Files, Job, Task, files_in
from cadcam.errors import WorkerDied

_TRIES = 3  # processes that may die over one view
_AHEAD = 2  # views under way or waiting, a worker: enough to keep them busy
# not -m: as __main__ the module would hold a second set of the classes that its input is made of
_COMMAND = (sys.executable, "-P", "-c", "from cadcam.dataset.worker import main; main()")
# One thread a process: the processes are the parallelism, and sums of matrix products depend on how they are shared.
_ENVIRONMENT = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")


def cores() -> int:
    """Return how many processors this process may use."""
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:  # not on every system
        return os.cpu_count() or 1


def on_processes(job: Job, tasks: Iterable[Task], workers: int) -> Iterator[Files]:
    """Yield the files of each task as they come, in any order, made by `workers` processes.

    Raises the `CadcamError` that a task ended with, and `WorkerDied` where process after process died over one.
    """
    told = pickle.dumps(job, protocol=pickle.HIGHEST_PROTOCOL)
    started: list[_Worker] = []
    idle: SimpleQueue[_Worker] = SimpleQueue()
    for _ in range(workers):
        started.append(_Worker(told))
        idle.put(started[-1])

    def made(task: Task) -> Files:
        worker = idle.get()
        try:
            return worker.files(task)
        finally:
            idle.put(worker)

    pool = ThreadPoolExecutor(workers, thread_name_prefix="cadcam-dataset")
    try:
        yield from windowed((pool.submit(made, task) for task in tasks), _AHEAD * workers)
    finally:
        for worker in started:
            worker.end()
        pool.shutdown(cancel_futures=True)


def windowed(futures: Iterator[Future[Files]], most: int) -> Iterator[Files]:
    """Yield results as they come, with at most so many under way; `futures` starts each when it is asked for it."""
    under_way: set[Future[Files]] = set()
    while True:
        while len(under_way) < most and (future := next(futures, None)) is not None:
            under_way.add(future)
        if not under_way:
            return
        done, under_way = wait(under_way, return_when=FIRST_COMPLETED)
        for future in done:
            yield future.result()


class _Worker:
    """A process, and another in its place when it dies."""

    def __init__(self, told: bytes) -> None:
        self._told, self._new, self._ended = told, True, False
        self._process = self._start()

    def _start(self) -> subprocess.Popen[bytes]:
        return subprocess.Popen(
            _COMMAND, stdin=subprocess.PIPE, stdout=subprocess.PIPE, env={**os.environ, **_ENVIRONMENT}
        )

    def files(self, task: Task) -> Files:
        """Return the files of a task, however often the process dies, within reason."""
        code = 0
        for _ in range(_TRIES):
            try:
                return files_in(self._asked(task))
            except (OSError, EOFError, pickle.UnpicklingError):  # its pipes are closed, or broke off within an answer
                self._gone()
                if self._ended:
                    break
                code = self._process.returncode
                self._process, self._new = self._start(), True
        raise WorkerDied(
            f"view {task.shot.index}: {_TRIES} processes one after the other died over it (the last with {code}); "
            "if memory was short, try fewer --workers; what is done is kept"
        )

    def _asked(self, task: Task) -> Any:
        requests, answers = self._process.stdin, self._process.stdout
        assert requests is not None  # both were asked for as pipes
        assert answers is not None
        if self._new:
            requests.write(self._told)
            self._new = False
        pickle.dump(task, requests, protocol=pickle.HIGHEST_PROTOCOL)
        requests.flush()
        return pickle.load(answers)

    def end(self) -> None:
        """End the process: what it is at is not wanted."""
        self._ended = True
        self._process.kill()
        self._gone()

    def _gone(self) -> None:
        """Wait for the end of the process and close its pipes, with what nobody will read in them."""
        self._process.wait()
        for pipe in (self._process.stdin, self._process.stdout):
            with suppress(OSError):
                if pipe is not None:
                    pipe.close()
