"""Mutations of files for the fuzzers (bench/fuzz_*.py)."""

from __future__ import annotations

from collections.abc import Sequence

import atheris


def mutated(provider: atheris.FuzzedDataProvider, words: Sequence[bytes], seed: bytes) -> bytes:
    """A seed with pieces cut out, replaced by words or by any bytes, and put in."""
    found = bytearray(seed)
    for _ in range(provider.ConsumeIntInRange(1, 6)):
        at = provider.ConsumeIntInRange(0, len(found))
        cut = provider.ConsumeIntInRange(0, 30)
        if provider.ConsumeBool():
            piece = words[provider.ConsumeIntInRange(0, len(words) - 1)]
        else:
            piece = provider.ConsumeBytes(8)
        found[at : at + cut] = piece
    return bytes(found)
