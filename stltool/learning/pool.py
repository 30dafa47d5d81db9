"""Work spread over processes: this one, some of this machine, or a dask cluster's.

A process that dies is replaced, and its work is repeated elsewhere; work whose process dies repeatedly is given up.
Results come back in any order.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Future, ProcessPoolExecutor, wait
from contextlib import ExitStack, closing, contextmanager
from multiprocessing import resource_tracker
from typing import TYPE_CHECKING, Generic, TypeVar

from stltool.cluster import connected
from stltool.errors import SettingsError

if TYPE_CHECKING:
    from distributed import Client

_DEATHS = 3  # of processes at one piece of work, before it is given up
_DIED = "its worker process died repeatedly; use fewer workers if memory is short"
_GUARD = 'start workers under if __name__ == "__main__":, since each of them imports the script'
_ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
_Item = TypeVar("_Item")
_Result = TypeVar("_Result")


def require_main_process() -> None:
    """SettingsError in a worker that, while it starts, imports a script that would start workers again."""
    if getattr(multiprocessing.current_process(), "_inheriting", False):
        raise SettingsError(f"a worker process would start further workers; {_GUARD}")


def spread(
    work: Callable[[_Item], _Result], items: Sequence[_Item], workers: int, cluster: str | None = None
) -> Generator[tuple[_Item, _Result | str], None, None]:
    """`work` of every item, as they are done; a text where an item's process died or could not run it.

    Closing the iterator gives up the rest. Raises SettingsError where there are no such processes.
    """
    workers = min(workers, len(items))
    if cluster is not None and items:
        with connected(cluster, "a sweep on a cluster", "give --workers") as client:
            yield from _distributed(client, work, items)
    elif workers <= 1:
        for item in items:
            yield item, work(item)
    else:
        yield from _processes(work, items, workers)


# ------------------------------------------------------------------------------------------- processes of this machine


class _Worker(Generic[_Item, _Result]):
    """A process that does one piece of work at a time. A pool of one, so that its death says which work it was."""

    def __init__(self) -> None:
        self._pool = ProcessPoolExecutor(1, multiprocessing.get_context("spawn"), initializer=_prepare)
        try:
            with _for_children():
                self.started = self._pool.submit(os.getpid)  # the process starts here
        except OSError as error:
            raise SettingsError(f"a worker process did not start: {error.strerror}; use fewer workers") from None

    def submit(self, work: Callable[[_Item], _Result], item: _Item) -> Future[_Result]:
        """The work's future, whose exception is a BrokenExecutor where the process has died."""
        try:
            return self._pool.submit(work, item)
        except BrokenExecutor as error:
            future: Future[_Result] = Future()
            future.set_exception(error)
            return future

    def close(self) -> None:
        """End the process, in the middle of its work if need be."""
        if not isinstance(self.started.exception(), BrokenExecutor):
            for child in multiprocessing.active_children():
                if child.pid == self.started.result():
                    child.kill()
        self._pool.shutdown(cancel_futures=True)


def _processes(
    work: Callable[[_Item], _Result], items: Sequence[_Item], n_workers: int
) -> Generator[tuple[_Item, _Result | str], None, None]:
    """One piece of work a process, the next when it is done; what a process died of goes to a new one."""
    with ExitStack() as stack:
        workers: list[_Worker[_Item, _Result]] = [stack.enter_context(closing(_Worker())) for _ in range(n_workers)]
        if any(isinstance(worker.started.exception(), BrokenExecutor) for worker in workers):
            raise SettingsError(f"the worker processes did not start; {_GUARD}, or use 1 worker")
        waiting = deque((item, 0) for item in items)  # with how many processes died of it
        under_way: dict[Future[_Result], tuple[_Worker[_Item, _Result], _Item, int]] = {}
        while waiting or under_way:
            while waiting and workers:
                worker, (item, deaths) = workers.pop(), waiting.popleft()
                under_way[worker.submit(work, item)] = worker, item, deaths
            for future in wait(under_way, return_when=FIRST_COMPLETED).done:
                worker, item, deaths = under_way.pop(future)
                error = future.exception()
                if not isinstance(error, BrokenExecutor):
                    workers.append(worker)
                    yield item, future.result() if error is None else _could_not(error)
                    continue
                workers.append(stack.enter_context(closing(_Worker())))
                if deaths + 1 < _DEATHS:
                    waiting.appendleft((item, deaths + 1))
                else:
                    yield item, _DIED


def _prepare() -> None:
    """In a worker, first of all: a Ctrl-C at the terminal reaches all processes, and the one that asked ends this one;
    where that one is gone, so is this one.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    assert parent is not None

    def follow() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=follow, daemon=True).start()


@contextmanager
def _for_children() -> Iterator[None]:
    """What a process that starts now inherits: one thread for linear algebra, and Ctrl-C blocked."""
    before = {name: os.environ.get(name) for name in _ONE_THREAD}
    mask = None
    if hasattr(signal, "pthread_sigmask"):  # not so on Windows
        resource_tracker.ensure_running()  # which would unblock the signal when it starts
        mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        os.environ.update(_ONE_THREAD)
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
        if mask is not None:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)


def _could_not(error: BaseException) -> str:
    return f"the worker could not run it: {type(error).__name__}: {error}"


# ------------------------------------------------------------------------------------------------------- dask clusters


def _distributed(
    client: Client, work: Callable[[_Item], _Result], items: Sequence[_Item]
) -> Generator[tuple[_Item, _Result | str], None, None]:
    from distributed import KilledWorker, as_completed

    waiting = {client.submit(work, item, pure=False): item for item in items}
    try:
        for future in as_completed(list(waiting), loop=client.loop):
            item = waiting.pop(future)
            if future.status == "finished":
                yield item, future.result()
            elif future.status != "error":
                raise SettingsError("the connection to the dask scheduler was lost; rerun the same command to continue")
            else:
                error = future.exception()
                yield item, _DIED if isinstance(error, KilledWorker) else _could_not(error)
    finally:
        client.cancel(list(waiting))
