"""A dask cluster, reached by its scheduler's address. The only module that imports dask, with `learning/pool.py`."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from stltool.errors import SettingsError
from stltool.extras import require

if TYPE_CHECKING:
    from distributed import Client

_PATIENCE = 20.0  # seconds to wait for a scheduler


@contextmanager
def connected(cluster: str, what: str, otherwise: str) -> Iterator[Client]:
    """A client of the scheduler at this address. `what` needs it ("a sweep on a cluster"); `otherwise` is the way out.

    Raises MissingExtraError where dask is not installed, SettingsError where no scheduler answers.
    """
    require("distributed", what, otherwise)
    from distributed import Client
    from distributed.comm.addressing import get_address_host_port

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
