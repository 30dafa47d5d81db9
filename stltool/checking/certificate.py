"""Certificates: for every step and reachable state bounds that a few lines of integer arithmetic can re-check.

    U_t ≥ opt_c Σ n·U_{t+1} / D,      L_t ≤ Σ n·L_{t+1} / D under the policy,      P ∈ [Σ ι·L_0, Σ ι·U_0]

A policy attains L, and no policy exceeds U (docs/certificates.md; for a minimum the roles change). Bounds are integers
over a unit of the layer: a fixed point rounded outwards, or D^(h−t) without any rounding where the result is exact.
What a row lacks of 1 is added to U at full value, what it exceeds is taken from L. `stltool/recheck.py`, which shares
no code with this file, does the re-checking.
"""

from __future__ import annotations

import gzip
import hashlib
import itertools
import json
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from stltool.arguments import function, require
from stltool.arguments import path as path_of
from stltool.automata import FALSE, TRUE, UNDECIDED
from stltool.checking.backward import Progress
from stltool.checking.check import CheckResult
from stltool.checking.rational import follower, weights
from stltool.checking.reach import first_steps, policy_layers
from stltool.errors import CertificateError, FileError, RefusedError, SettingsError
from stltool.files import atomic_file, require_folder, require_own
from stltool.models import MDP
from stltool.models.fractions import LARGEST_SUM, Integers
from stltool.numbers import long_numbers
from stltool.policy import Policy
from stltool.product import Product
from stltool.recheck import DAMAGE, FORMAT, NotACertificate, Refused, lines
from stltool.recheck import certify as recheck
from stltool.sizes import require_memory

_PARTS = ("model", "automaton")
_FINE, _FINEST = 2**48, 2**60  # units in 1: enough for int64, and for Python's integers where int64 has fewer


def write_certificate(
    result: CheckResult, path: str | Path, memory_limit: int | None = None, progress: Progress | None = None
) -> tuple[Fraction, Fraction]:
    """Write what proves bounds of a result: JSON lines, packed where the name ends in .gz. Returns the bounds.

    They come from a fixed point of their own, so they may differ from the result's in the last digits.

    The result must have kept its policy. An exact result gets a certificate without any rounding.
    """
    require(result, CheckResult, "write_certificate's result")
    path = require_certificate_file(path_of(path, "write_certificate's path"))
    function(progress, "write_certificate's progress")
    if result.policy is None:
        raise SettingsError("a certificate lists the policy; check with keep_policy=True")
    product, policy = result.product, result.policy
    if result.question == "policy":
        product, policy = policy.on(product)
    per_number = (
        8.0 if result.fraction is None else 40 + product.horizon * product.model.exact().denominator.bit_length() / 8
    )
    require_memory(
        3 * per_number * product.model.n_transitions * product.automaton.n_states
        + product.n_states * product.horizon / 8,
        f"certifying {product.n_states} product states over {product.horizon} steps",
        "certify a shorter task",
        memory_limit,
    )
    parts = _parts(product, policy, result)
    part: dict[str, Any] = {}
    with long_numbers(), atomic_file(path) as file, _packed(file, path) as out:
        seal = hashlib.sha256()
        for part in parts:
            line = (json.dumps(part, separators=(",", ":"), ensure_ascii=False) + "\n").encode()
            seal.update(line)
            out.write(line)
            if progress is not None and "t" in part:
                progress(product.horizon - part["t"], product.horizon)
        out.write((json.dumps({"sha256": seal.hexdigest()}) + "\n").encode())
        return Fraction(part["lower"]), Fraction(part["upper"])


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
    try:
        return bool(next(lines(str(path)), {}).get("format") == FORMAT)
    except (Refused, *DAMAGE):
        return False


@long_numbers()
def require_certificate_of(path: str | Path, product: Product, policy: Policy | None = None) -> None:
    """CertificateError, with what differs, unless a certificate speaks of this product's task, model and automaton.

    With `policy`, its claim must also be about that policy, choice by choice. The bounds are not checked again here:
    call `stltool.certify` first.
    """
    if product.model.intervals is not None:
        product = replace(product, model=product.model.nominal())  # certificates are of one distribution
    items = lines(str(path))
    header, *found = itertools.islice(items, 3)
    if policy is not None:
        product, policy = policy.on(product)
    own = _header(product, "policy", policy)
    for key in ("formula", "horizon", *(["claim"] if policy is not None else [])):
        if header.get(key) != own[key]:
            what = "task" if key == "formula" else key
            raise CertificateError(f"{path}: the {what} of this certificate is {header.get(key)}, not {own[key]}")
    for part, mine, what in zip(found, (_model_part(product.model), _automaton_part(product)), _PARTS, strict=True):
        for key, value in mine.items():
            if part.get(key) != value:
                if policy is None and header.get("claim") == "policy" and what == "automaton":
                    raise CertificateError(
                        f"{path}: this certificate is of a policy with a memory of its own; give --policy too"
                    )
                raise CertificateError(
                    f"{path}: this certificate is of another {what} (its {key} differs; the model there is called "
                    f"{header.get('model')}, here {product.model.name}); write one with stltool check --certificate"
                )
    if policy is not None:
        for layer in itertools.takewhile(lambda item: "t" in item, items):
            s, q = np.divmod(np.array(layer["at"], dtype=np.int64), product.automaton.n_states)
            if layer["choice"] != _listed(product.model, policy.row(layer["t"]), s, q):
                raise CertificateError(f"{path}: this certificate is of another policy (step {layer['t']} differs)")


def _parts(product: Product, policy: Policy, result: CheckResult) -> Iterator[dict[str, Any]]:
    """The lines of the file: header, model, automaton, layers from the last step back, conclusion."""
    yield _header(product, result.question, policy)
    yield _model_part(product.model)
    yield _automaton_part(product)
    lower, upper = yield from _layers(product, policy, result.question, rounded=result.fraction is None)
    yield {"lower": str(lower), "upper": str(upper)}


def _header(product: Product, claim: str, policy: Policy | None) -> dict[str, Any]:
    return {
        "format": FORMAT,
        "claim": claim,
        "task": product.task_name,
        "formula": str(product.formula),
        "encoding": product.automaton.encoding,
        "horizon": product.horizon,
        "model": product.model.name,
        "policy": policy.kind if policy is not None else None,
    }


def _model_part(model: MDP) -> dict[str, Any]:
    exact = model.exact()
    target, numerator = model.target.tolist(), exact.numerator.tolist()
    flat = [number for pair in zip(target, numerator, strict=True) for number in pair]
    cuts = (2 * model.row_start).tolist()
    rows = [flat[a:b] for a, b in itertools.pairwise(cuts)]
    return {
        "denominator": exact.denominator,
        "initial": [[int(s), int(exact.initial[s])] for s in np.flatnonzero(model.initial)],
        "initial_denominator": exact.initial_denominator,
        "choices": [rows[a:b] for a, b in itertools.pairwise(model.choice_start.tolist())],
    }


def _automaton_part(product: Product) -> dict[str, Any]:
    automaton = product.automaton
    return {
        "memory": automaton.n_states,
        "start": int(automaton.initial),
        "letter": product.letter.tolist(),
        "delta": automaton.delta.tolist(),
        "verdicts": [
            [int(t), row] for t, row in zip(automaton.verdict_starts, automaton.verdict_rows.tolist(), strict=True)
        ],
    }


def _layers(
    product: Product, policy: Policy, claim: str, rounded: bool
) -> Generator[dict[str, Any], None, tuple[Fraction, Fraction]]:
    """Layer after layer from step h−1 down to 0; returns the bounds that layer 0 proves."""
    model, automaton, h = product.model, product.automaton, product.horizon
    exact = model.exact()
    D = exact.denominator
    numerator: Integers = exact.numerator
    one = 1 if not rounded else LARGEST_SUM // D if LARGEST_SUM // D >= _FINE else _FINEST
    if not rounded or one * D > LARGEST_SUM or not policy.deterministic:
        numerator = numerator.astype(object)
    lack = D - np.add.reduceat(numerator, model.row_start[:-1])[:, None]
    reached = _support(product, policy if claim == "policy" else None)
    after = automaton.delta[product.letter][model.target]  # (transitions, Q)
    high = np.zeros(product.shape, dtype=numerator.dtype)
    high[:, automaton.verdicts(h) == TRUE] = one
    low = high.copy()
    for t in range(h - 1, -1, -1):
        highs, lows = (
            np.add.reduceat(numerator[:, None] * values[model.target[:, None], after], model.row_start[:-1], axis=0)
            for values in (high, low)
        )
        highs, lows = highs + np.maximum(lack, 0) * one, lows + np.minimum(lack, 0) * one
        chosen, shared = follower(model, policy.row(t))
        if claim == "maximum":
            high, low = np.maximum.reduceat(highs, model.choice_start[:-1], axis=0) * shared, chosen(lows)
        elif claim == "minimum":
            high, low = chosen(highs), np.minimum.reduceat(lows, model.choice_start[:-1], axis=0) * shared
        else:
            high, low = chosen(highs), chosen(lows)
        if rounded:
            high, low = -((-high) // (D * shared)), low // (D * shared)
        else:
            one *= D * shared
        verdicts = automaton.verdicts(t)
        for values in (high, low):
            values[:, verdicts == TRUE] = one
            values[:, verdicts == FALSE] = 0
        s, q = np.nonzero(reached(t) & (verdicts == UNDECIDED))
        yield {
            "t": t,
            "one": one,
            "at": (s * automaton.n_states + q).tolist(),
            "lower": low[s, q].tolist(),
            "upper": high[s, q].tolist(),
            "choice": _listed(model, policy.row(t), s, q),
        }
    entry = automaton.delta[product.letter, automaton.initial]
    start = np.flatnonzero(model.initial)
    total, sure = exact.initial_denominator, one * exact.initial_denominator
    missing = (total - sum(exact.initial.tolist())) * one
    lower, upper = (
        sum(int(exact.initial[s]) * int(values[s, entry[s]]) for s in start.tolist()) for values in (low, high)
    )
    return Fraction(lower + min(0, missing), sure), Fraction(upper + max(0, missing), sure)


def _listed(model: MDP, table: NDArray[Any], s: NDArray[np.int64], q: NDArray[np.int64]) -> list[Any]:
    """The choices of a deterministic policy, or the whole-number weights of a mixture."""
    if table.dtype.kind == "i":
        choices: list[Any] = table[s, q].tolist()
        return choices
    shares, _ = weights(table)
    n_choices = np.diff(model.choice_start)
    return [row[:n].tolist() for row, n in zip(shares[s, q], n_choices[s], strict=True)]


def _support(product: Product, policy: Policy | None) -> Callable[[int], NDArray[np.bool_]]:
    """step → (S, Q): which pairs a layer lists, closed under steps of the policy, or of any where there is none."""
    if policy is None:
        first = first_steps(product)
        return lambda t: first <= t
    layers = policy_layers(product, policy)
    return lambda t: np.unpackbits(layers[t], count=product.n_states).astype(np.bool_).reshape(product.shape)


@contextmanager
def _packed(file: IO[bytes], path: Path) -> Iterator[IO[bytes]]:
    if path.suffix.lower() != ".gz":
        yield file
        return
    with gzip.GzipFile("", "wb", fileobj=file, mtime=0) as packed:  # the same bytes for the same result
        yield packed  # type: ignore[misc]
