"""Certificates: proofs of bounds, re-checked by one short file that shares no code with the writer.

proof.py makes their contents, docs/certificates.md describes them, `stltool/recheck.py` re-checks them.
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
    denominator_of,
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
    """Write a proof of bounds on a result: JSON lines, compressed if the name ends in .gz. Returns the bounds.

    The bounds come from a separate computation, so they may differ from the result's in the last digits; for an exact
    result they are the exact value. On a model with intervals they hold for nature's choice, as in `robust_check`. The
    result need not have kept its policy. With `cluster`, the address of a dask scheduler, its workers compute the
    numbers; the file is the same.

    Raises SizeError before allocating more memory than is available, or if the certificate would be too large for its
    reader.
    """
    require(result, CheckResult, "write_certificate's result")
    path = require_certificate_file(path_of(path, "write_certificate's path"))
    function(progress, "write_certificate's progress")
    product, policy = result.product, result.policy if result.question == "policy" else None
    if result.natures_aim is None or product.model.parameters:
        product.model.require_points()
    if policy is not None:
        product, policy = policy.on(product)
    require(cluster, str, "write_certificate's cluster", "write the scheduler's address in quotes", optional=True)
    exact = result.fraction is not None
    if cluster is not None:
        product.model.require_points()
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
            proof = Proof(product, policy, result.question, exact, budget, memory_limit, client, result.natures_aim)
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


_BLOCK = 4096  # model states compared at a time
_json = json.JSONEncoder(separators=(",", ":"), ensure_ascii=False).encode


def certify(path: str | Path, progress: Progress | None = None) -> dict[str, Any]:
    """Re-check a certificate in exact integers, by code that shares nothing with its writer (recheck.py).

    Returns its header with the counts; `lower` and `upper` are fractions as strings. Raises RefusedError if it does not
    prove its bounds, CertificateError if the file is not a certificate, FileError if it cannot be read.
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
        raise FileError(f"{path}: this certificate does not exist") from None
    except OSError as error:
        raise FileError(f"{path}: this certificate cannot be read: {error.strerror}") from None


def require_certificate_file(path: str | Path) -> Path:
    """The path where a certificate may be written; FileError if that would overwrite another kind of file."""
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
    """CertificateError, with what differs, unless a certificate is for this product's task, model and automaton.

    With `policy`, its claim must also be about that policy, choice by choice. The bounds are not checked again here:
    call `stltool.certify` first.
    """
    product.model.require_probabilities()
    try:
        _require_same(path, product, policy)
    except (Refused, *DAMAGE) as error:
        raise CertificateError(f"{path}: not a certificate, or a damaged one: {error}") from None


def _require_same(path: str | Path, product: Product, policy: Policy | None) -> None:
    items = iter(Lines(str(path)))
    theirs = next(items)
    assert isinstance(theirs, dict)
    if theirs["nature"] is not None and (not product.model.uncertain or product.model.parameters):
        raise CertificateError(
            f"{path}: this certificate is for a model with intervals, unlike {product.model.name}; write one with "
            "stltool check --certificate"
        )
    if theirs["nature"] is None and product.model.uncertain:
        product = replace(product, model=product.model.nominal())
    if policy is not None:
        product, policy = policy.on(product)
    own = header(product, "policy", policy)
    for key in ("formula", "horizon", *(["claim"] if policy is not None else [])):
        if theirs[key] != own[key]:
            what = "task" if key == "formula" else key
            remedy = "; leave out --policy" if key == "claim" else ""
            raise CertificateError(f"{path}: the {what} of this certificate is {theirs[key]}, not {own[key]}{remedy}")
    same, letters, item = _same_model(product, items)
    if not same:
        raise CertificateError(
            f"{path}: this certificate is for another model ({theirs['model']}, not {product.model.name}); "
            "write one with stltool check --certificate"
        )
    for mine in automaton_items(product):
        if not letters or mine != item:
            if policy is None and theirs["claim"] == "policy":
                remedy = "it is for a policy with its own automaton; give --policy too"
            else:
                remedy = "write one with stltool check --certificate"
            raise CertificateError(f"{path}: this certificate is for another automaton; {remedy}")
        item = next(items)
    if policy is not None:
        layers = following(product, policy, Budget("a certificate's policy"))
        listed = _policy_items(itertools.chain([item], items))
        for mine in PolicyItems(layers, product, policy.form).all():
            if isinstance(mine, dict):
                steps = mine["policy"]
            if mine != next(listed, None):
                raise CertificateError(
                    f"{path}: this certificate is for another policy (steps {steps[0]} to {steps[1]} differ); give the "
                    "policy that it was written for"
                )


def _same_model(product: Product, items: Iterator[Item]) -> tuple[bool, bool, Item]:
    """Whether the states listed are the model's, whether their letters are the model's, and the item after them."""
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
        own_D, size = denominator_of(rows), 2 if rows.intervals is None else 3
        for row, own in zip(acting, choices_listed(rows), strict=True):
            if len(row) - 3 != len(own):
                return False, letters, item
            for theirs, ours in zip(row[3:], own, strict=True):
                if theirs and theirs[::size] != ours[::size]:
                    return False, letters, item
                for k in range(1, size):
                    if theirs and [n * own_D for n in theirs[k::size]] != [n * D for n in ours[k::size]]:
                        return False, letters, item
    return not share_of, letters, item


def _policy_items(items: Iterator[Item]) -> Iterator[Item]:
    """The choices in a policy's blocks."""
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
