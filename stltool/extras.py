"""Packages that a plain installation does not include, with their extras; errors for missing ones name the extra."""

from __future__ import annotations

import importlib
from typing import Any

from stltool.errors import MissingExtraError

EXTRAS = {
    "cma": "falsify",
    "optuna": "falsify",
    "distributed": "cluster",
    "gymnasium": "gymnasium",
    "mcap": "mcap",
    "pyarrow": "parquet",
    "tensorboard": "tensorboard",
    "sklearn": "trees",
    "stormpy": "storm",
}
"""Package → the extra of stltool that installs it."""


def require(package: str, what: str, otherwise: str = "") -> Any:
    """Import an extra's package. Raises MissingExtraError if that fails.

    what       the feature that needs the package ("a sweep on a cluster"); it begins the message
    otherwise  the alternative ("write the trace as .csv")
    """
    try:
        return importlib.import_module(package)
    except ImportError as error:
        absent = isinstance(error, ModuleNotFoundError) and error.name == package
        fault = "which is not installed" if absent else f"which cannot be imported ({error})"
        remedy = f"pip install 'stltool[{EXTRAS[package]}]'" + (f", or {otherwise}" if otherwise else "")
        raise MissingExtraError(f"{what} needs the package {package}, {fault}; {remedy}") from None
