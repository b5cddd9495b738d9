"""Views made on a Dask cluster: the same files, on all its machines. The only file that imports Dask.

Workers need cadcam installed and nothing else: the model, the shots and the photos are sent to them, the files back.
Dask itself reassigns the work of a worker that dies; a worker that joins later is given the job then.
"""

from __future__ import annotations

import threading
from collections.abc import Iterable, Iterator
from importlib.util import find_spec
from itertools import islice
from typing import TYPE_CHECKING

from cadcam.dataset.worker import Answer, Files, Job, Maker, Task, files_in
from cadcam.errors import MissingExtra, UnreachableCluster, WorkerDied

if TYPE_CHECKING:
    from distributed import Client

_AHEAD = 4  # views in progress or waiting, per thread of the cluster
_PATIENCE_S = 20
_kept = threading.local()  # the maker of a thread, and its job


def require_dask() -> None:
    """Raise `MissingExtra` where Dask is not installed."""
    if find_spec("distributed") is None:
        raise MissingExtra("a data set on a cluster", "cluster", "distributed")


def on_cluster(job: Job, tasks: Iterable[Task], address: str) -> Iterator[Files]:
    """Yield the files of each task as they arrive, in any order, made by the cluster at `address`.

    Raises `MissingExtra` without Dask, `UnreachableCluster`, `WorkerDied`, and the error that a task ended with.
    """
    require_dask()
    from distributed import KilledWorker, as_completed

    client = _connected(address)
    with client, client.as_current():
        threads = sum(client.nthreads().values())
        if not threads:
            raise UnreachableCluster(address, "it has no workers")
        shared_job = client.scatter(job, broadcast=True, hash=False)
        work = (client.submit(_answer, shared_job, task, pure=False) for task in tasks)
        running = as_completed(islice(work, _AHEAD * threads))
        for future in running:
            try:
                answer = future.result()
            except KilledWorker as error:
                raise WorkerDied(f"on the cluster: {error}; what is done is kept") from None
            yield files_in(answer)
            for more in islice(work, 1):
                running.add(more)


def _connected(address: str) -> Client:
    """Return a client of the scheduler at an address. Raises `UnreachableCluster`."""
    from distributed import Client
    from distributed.comm import get_address_host_port

    try:  # before there is a client, which cannot be closed without an address
        get_address_host_port(address, strict=True)
    except ValueError as error:
        raise UnreachableCluster(address, str(error)) from None
    try:
        return Client(address, timeout=_PATIENCE_S, set_as_default=False)
    except (OSError, ValueError) as error:
        raise UnreachableCluster(address, str(error) or type(error).__name__) from None


def _answer(job: Job, task: Task) -> Answer:
    """Make a view on a worker, where each thread keeps what it needs for the views of one job."""
    if getattr(_kept, "job", None) is not job:
        _kept.job, _kept.maker = job, Maker(job)
    answer: Answer = _kept.maker.answer(task)
    return answer
