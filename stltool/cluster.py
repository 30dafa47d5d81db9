"""A dask cluster, reached by its scheduler's address. Only this module and `learning/pool.py` import dask."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from concurrent.futures import CancelledError
from contextlib import contextmanager
from importlib import metadata
from typing import TYPE_CHECKING

from stltool.errors import SettingsError, SizeError
from stltool.extras import require
from stltool.kernels.jit import SOURCES

if TYPE_CHECKING:
    from distributed import Client

_PATIENCE = 20.0  # seconds to wait for a scheduler


def _require_workers(client: Client, cluster: str) -> None:
    """SettingsError unless there are workers, and all of them run the same stltool."""
    try:
        client.wait_for_workers(1, timeout=_PATIENCE)
    except TimeoutError:
        raise SettingsError(
            f"the dask scheduler at {cluster} has no workers; start some: dask worker {cluster}"
        ) from None
    mine = this_version()
    for worker, found in client.run(this_version, on_error="return").items():
        if found != mine:
            what = f"stltool {found}" if isinstance(found, str) else f"no stltool ({found})"
            raise SettingsError(
                f"the dask worker at {worker} has {what}, not stltool {mine} as here; install the same version on both"
            )


def this_version() -> str:
    """Identifies this version of stltool: equal versions give equal bits."""
    return f"{metadata.version('stltool')} ({SOURCES})"


@contextmanager
def connected(cluster: str, what: str, otherwise: str) -> Iterator[Client]:
    """A client of the scheduler at this address. `what` needs it ("a sweep on a cluster"); `otherwise` is the remedy
    without one.

    Raises MissingExtraError if dask is not installed, SettingsError if no scheduler answers or the connection is lost,
    SizeError if a task kills every worker that tries it.
    """
    require("distributed", what, otherwise)
    from distributed import Client, KilledWorker
    from distributed.comm.addressing import get_address_host_port
    from distributed.comm.core import CommClosedError

    for handler in logging.getLogger("distributed").handlers:  # our errors report what matters
        handler.setLevel(logging.CRITICAL)
    try:
        get_address_host_port(cluster)
        client = Client(cluster, timeout=_PATIENCE, set_as_default=False)
    except (OSError, ValueError) as error:
        raise SettingsError(
            f"no dask scheduler answers at {cluster}: {error}; write, for example, tcp://host:8786"
        ) from None
    with client:
        try:
            _require_workers(client, cluster)
            yield client
        except KilledWorker as error:
            raise SizeError(
                f"a step of {what} killed every worker that tried it, most recently {error.last_worker.address}; give "
                "the workers more memory, or use more workers"
            ) from None
        except (CancelledError, CommClosedError) as error:
            raise SettingsError(f"the connection to the dask scheduler at {cluster} was lost: {error}") from None
