"""Work spread over processes: this one, some of this machine, or a dask cluster's. The only module with dask in it.

A process that dies is replaced, and its work is done again elsewhere; work whose process dies again and again is given
up. Results come back in any order.
"""

from __future__ import annotations

import logging
import multiprocessing
import signal
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, TypeVar

from stltool.errors import SettingsError

if TYPE_CHECKING:
    from distributed import Client

_PATIENCE = 20.0  # seconds to wait for a scheduler
_GUARD = 'a script that starts workers does so under if __name__ == "__main__":, for each of them imports it'
_Item = TypeVar("_Item")
_Result = TypeVar("_Result")


def require_main_process() -> None:
    """SettingsError in a worker that, while it starts, imports a script that would start workers again."""
    if getattr(multiprocessing.current_process(), "_inheriting", False):
        raise SettingsError(f"a worker process would start workers of its own; {_GUARD}")


def spread(
    work: Callable[[_Item], _Result], items: Sequence[_Item], workers: int, cluster: str | None = None
) -> Generator[tuple[_Item, _Result | str], None, None]:
    """`work` of every item, as they are done; a text where an item's process died or could not run it.

    Closing the iterator gives up the rest. Raises SettingsError where there are no such processes.
    """
    workers = min(workers, len(items))
    if cluster is None and workers <= 1:
        for item in items:
            yield item, work(item)
    elif items:
        with _client(workers, cluster) as client:
            yield from _distributed(client, work, items)


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
                raise SettingsError("the connection to the dask scheduler was lost; the same command goes on from here")
            elif isinstance(error := future.exception(), KilledWorker):
                yield item, "its worker process died again and again; is there too little memory for so many workers?"
            else:
                yield item, f"the worker could not run it: {type(error).__name__}: {error}"
    finally:
        client.cancel(list(waiting))


@contextmanager
def _client(workers: int, cluster: str | None) -> Iterator[Client]:
    try:
        from distributed import Client, LocalCluster, WorkerPlugin
        from distributed.comm.addressing import get_address_host_port
    except ImportError:
        raise SettingsError(
            "more than one worker, or a cluster, needs dask.distributed; pip install 'stltool[sweep]', or take 1 worker"
        ) from None
    if cluster is not None:
        for handler in logging.getLogger("distributed").handlers:  # what matters is told by our errors
            handler.setLevel(logging.CRITICAL)
        try:
            get_address_host_port(cluster)
            client = Client(cluster, timeout=_PATIENCE, set_as_default=False)
        except (OSError, ValueError) as error:
            raise SettingsError(
                f"no dask scheduler answers at {cluster}: {error}; write for example tcp://host:8786"
            ) from None
        with client:
            yield client
        return
    try:
        local = LocalCluster(
            n_workers=workers,
            threads_per_worker=1,
            processes=True,
            dashboard_address=None,
            silence_logs=logging.CRITICAL,
        )
    except RuntimeError as error:
        raise SettingsError(f"the worker processes did not start ({error}); {_GUARD}, or take 1 worker") from None

    class Deaf(WorkerPlugin):
        """A Ctrl-C at the terminal reaches all processes; this one ends the workers."""

        def setup(self, worker: object) -> None:
            signal.signal(signal.SIGINT, signal.SIG_IGN)

    with local, Client(local, set_as_default=False) as client:
        client.register_plugin(Deaf())
        yield client
