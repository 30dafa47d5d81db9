"""Random numbers: one seed, with a separate stream for every purpose.

A stream is the generator of `SeedSequence(seed, spawn_key=(purpose, …))`. Streams of different keys behave as if
independent, so a learner's data and the runs that judge its policy are independent even under the same seed.

Seeds stay below 2¹²⁸: the sequence appends a key to the seed's words, so a longer seed could equal a shorter one with
its key.
"""

from __future__ import annotations

from enum import IntEnum, unique

import numpy as np

from stltool.arguments import described
from stltool.errors import SettingsError, named

_MOST_BITS = 128


@unique
class Purpose(IntEnum):
    """The purpose of a stream. Numbers are never reassigned, since the results of a seed would change."""

    LEARNING_ENVIRONMENT = 0
    """The first states and successors that a learner sees."""
    LEARNER = 1
    """A learner's own choices: exploration, ties, draws from its memory."""
    ESTIMATE = 2
    """`estimate`: fresh runs of a policy."""
    SPRT = 3
    """`sprt`: fresh runs of a policy."""
    SAMPLE_RUN = 4
    """`sample_run`: one run, step by step."""
    MARKOV_TEST = 5
    """`markov_test`: tables with the same margins as the data."""
    FALSIFY = 6
    """`stltool.testing.falsify`: which inputs are executed."""
    SAMPLED = 7
    """`stltool.testing.assert_probability_sampled`: what each run is given."""


def generator(seed: int, purpose: Purpose, *part: int) -> np.random.Generator:
    """The stream of a seed for a purpose, and separate for every `part` (a block of runs, say).

    Raises SettingsError if `seed` is not an integer from 0 to 2¹²⁸ − 1.
    """
    return np.random.default_rng(np.random.SeedSequence(require_seed(seed), spawn_key=(int(purpose), *part)))


def require_seed(seed: int) -> int:
    """The seed as a Python int; SettingsError if it is not one. NumPy's integers are fine, Booleans are not."""
    if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or not 0 <= seed < 1 << _MOST_BITS:
        raise SettingsError(f"{named('seed')} is {described(seed)}; give an integer from 0 (below 2^{_MOST_BITS})")
    return int(seed)
