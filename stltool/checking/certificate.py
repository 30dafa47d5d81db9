"""Certificates: proofs of bounds that one short file can re-check, which shares no code with what wrote them.

What they list is made in proof.py and described in docs/certificates.md; `stltool/recheck.py` does the re-checking.
"""

from __future__ import annotations

import gzip
import hashlib
import itertools
import json
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import IO, Any

import numpy as np

from stltool.arguments import function, require
from stltool.arguments import path as path_of
from stltool.checking.check import CheckResult, require_for_cluster, undefined
from stltool.checking.induction import Budget, Progress, Silent
from stltool.checking.proof import (
    SMALLER,
    Item,
    PolicyItems,
    Proof,
    automaton_items,
    choices_listed,
    following,
    header,
)
from stltool.cluster import connected
from stltool.errors import CertificateError, FileError, RefusedError, SizeError
from stltool.files import atomic_file, require_folder, require_own
from stltool.numbers import long_numbers
from stltool.policy import Policy
from stltool.product import Product
from stltool.recheck import DAMAGE, FORMAT, LINE, Lines, NotACertificate, Refused
from stltool.recheck import certify as recheck


def write_certificate(
    result: CheckResult,
    path: str | Path,
    memory_limit: int | None = None,
    progress: Progress | None = None,
    *,
    cluster: str | None = None,
) -> tuple[Fraction, Fraction]:
    """Write what proves bounds of a result: JSON lines, packed where the name ends in .gz. Returns the bounds.

    They come from a computation of their own, so they may differ from the result's in the last digits; of an exact
    result they are the exact value. The result need not have kept its policy. `cluster`, the
    address of a dask scheduler: its workers compute the numbers; the file is the same.

    Raises SizeError before it takes memory that is not there, or where the certificate would be too large for its
    reader.
    """
    require(result, CheckResult, "write_certificate's result")
    path = require_certificate_file(path_of(path, "write_certificate's path"))
    function(progress, "write_certificate's progress")
    product, policy = result.product, result.policy if result.question == "policy" else None
    product.model.require_points()
    if policy is not None:
        product, policy = policy.on(product)
    require(cluster, str, "write_certificate's cluster", "write the scheduler's address in quotes", optional=True)
    exact = result.fraction is not None
    if cluster is not None:
        require_for_cluster(exact, policy)
    what = f"certifying {product.n_states} product states over {product.horizon} steps"
    with ExitStack() as open_things:
        client = None
        if cluster is not None:
            client = open_things.enter_context(connected(cluster, "a certificate on a cluster", "leave it out"))
        open_things.enter_context(long_numbers())
        out = open_things.enter_context(_packed(open_things.enter_context(atomic_file(path)), path))
        seal = hashlib.sha256()
        budget = Budget(what, memory_limit, progress)
        try:
            proof = Proof(product, policy, result.question, exact, budget, memory_limit, client)
            for item in proof.items():
                seal.update(_write(out, item))
        except Silent:
            assert policy is not None
            raise undefined(product, policy) from None
        lower, upper = proof.bounds
        seal.update(_write(out, {"lower": str(lower), "upper": str(upper)}))
        _write(out, {"sha256": seal.hexdigest()})
        return lower, upper


def _write(out: IO[bytes], item: Item) -> bytes:
    line = ((item if isinstance(item, str) else _json(item)) + "\n").encode()
    if len(line) > LINE:
        raise SizeError(f"a line of the certificate would have {len(line)} bytes, more than {LINE}; {SMALLER}")
    out.write(line)
    return line


_BLOCK = 4096  # model states that are compared at a time
_json = json.JSONEncoder(separators=(",", ":"), ensure_ascii=False).encode


def certify(path: str | Path, progress: Progress | None = None) -> dict[str, Any]:
    """Re-check a certificate in exact integers, by code that shares nothing with what wrote it (recheck.py).

    Returns its header with what was counted; `lower` and `upper` are fractions as texts. Raises RefusedError where it
    does not prove its bounds, CertificateError where it is not a certificate, FileError where it cannot be read.
    """
    path = path_of(path, "certify's path")
    function(progress, "certify's progress")
    try:
        return recheck(str(path), progress)
    except NotACertificate as refusal:
        raise CertificateError(f"{path}: {refusal}; write one with stltool check --certificate") from None
    except Refused as refusal:
        raise RefusedError(f"{path}: refused: {refusal}") from None
    except FileNotFoundError:
        raise FileError(f"{path}: there is no such certificate") from None
    except OSError as error:
        raise FileError(f"{path}: this certificate cannot be read: {error.strerror}") from None


def require_certificate_file(path: str | Path) -> Path:
    """The path where a certificate may be written; FileError where that would lose a file that is none."""
    path = Path(path)
    require_own(path, "certificate", _is_certificate)
    require_folder(path.resolve().parent)
    return path


def _is_certificate(path: Path) -> bool:
    """Whether a file is a certificate, of this version or another."""
    try:
        first = next(iter(Lines(str(path))), {})
        return isinstance(first, dict) and str(first["format"]).rpartition("-")[0] == FORMAT.rpartition("-")[0]
    except (Refused, *DAMAGE):
        return False


@long_numbers()
def require_certificate_of(path: str | Path, product: Product, policy: Policy | None = None) -> None:
    """CertificateError, with what differs, unless a certificate speaks of this product's task, model and automaton.

    With `policy`, its claim must also be about that policy, choice by choice. The bounds are not checked again here:
    call `stltool.certify` first.
    """
    if product.model.uncertain:
        product = replace(product, model=product.model.nominal())  # certificates are of one distribution
    product.model.require_points()
    try:
        _require_same(path, product, policy)
    except (Refused, *DAMAGE) as error:
        raise CertificateError(f"{path}: not a certificate, or a damaged one: {error}") from None


def _require_same(path: str | Path, product: Product, policy: Policy | None) -> None:
    items = iter(Lines(str(path)))
    theirs = next(items)
    assert isinstance(theirs, dict)
    if policy is not None:
        product, policy = policy.on(product)
    own = header(product, "policy", policy)
    for key in ("formula", "horizon", *(["claim"] if policy is not None else [])):
        if theirs[key] != own[key]:
            what = "task" if key == "formula" else key
            raise CertificateError(f"{path}: the {what} of this certificate is {theirs[key]}, not {own[key]}")
    same, letters, item = _same_model(product, items)
    if not same:
        raise CertificateError(
            f"{path}: this certificate is of another model (called {theirs['model']}, here {product.model.name}); "
            "write one with stltool check --certificate"
        )
    for mine in automaton_items(product):
        if not letters or mine != item:
            if policy is None and theirs["claim"] == "policy":
                remedy = "it is of a policy that remembers in its own way; give --policy too"
            else:
                remedy = "write one with stltool check --certificate"
            raise CertificateError(f"{path}: this certificate is of another automaton; {remedy}")
        item = next(items)
    if policy is not None:
        layers = following(product, policy, Budget("a certificate's policy"))
        listed = _policy_items(itertools.chain([item], items))
        for mine in PolicyItems(layers, product, policy.form).all():
            if isinstance(mine, dict):
                steps = mine["policy"]
            if mine != next(listed, None):
                raise CertificateError(
                    f"{path}: this certificate is of another policy (steps {steps[0]} to {steps[1]} differ); give the "
                    "policy that it was written for"
                )


def _same_model(product: Product, items: Iterator[Item]) -> tuple[bool, bool, Item]:
    """Whether the states listed are the model's, whether they are read as its letters are, and the item after them."""
    head, model = next(items), product.model
    assert isinstance(head, dict)
    D, total = head["denominator"], head["initial_denominator"]
    share_of = {s: model.initial_share(s) * total for s in np.flatnonzero(model.initial).tolist()}
    asked, letters, item = model.some_rows(), True, next(items)
    while isinstance(item, list):
        block: list[list[Any]] = []
        while isinstance(item, list) and len(block) < _BLOCK:
            block.append(item)
            item = next(items)
        if any(not 0 <= row[0] < model.n_states or row[1] != share_of.pop(row[0], 0) for row in block):
            return False, letters, item
        letters &= [row[2] for row in block] == product.letter[[row[0] for row in block]].tolist()
        acting = [row for row in block if len(row) > 3]
        numbers = asked.at(np.array([row[0] for row in acting], dtype=np.int64))
        rows = asked.rows.some(numbers)
        for row, own in zip(acting, choices_listed(rows), strict=True):
            if len(row) - 3 != len(own):
                return False, letters, item
            for theirs, ours in zip(row[3:], own, strict=True):
                if theirs and theirs[::2] != ours[::2]:
                    return False, letters, item
                if theirs and [n * rows.denominator for n in theirs[1::2]] != [n * D for n in ours[1::2]]:
                    return False, letters, item
    return not share_of, letters, item


def _policy_items(items: Iterator[Item]) -> Iterator[Item]:
    """Those of a policy's blocks."""
    inside = False
    for item in items:
        inside = "policy" in item if isinstance(item, dict) else inside
        if inside:
            yield item


@contextmanager
def _packed(file: IO[bytes], path: Path) -> Iterator[IO[bytes]]:
    if path.suffix.lower() != ".gz":
        yield file
        return
    with gzip.GzipFile("", "wb", 6, fileobj=file, mtime=0) as packed:  # the same bytes for the same result
        yield packed  # type: ignore[misc]
