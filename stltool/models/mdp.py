"""A Markov decision process with named signals, labels, states and actions, validated once, on construction.

Transitions are CSR rows (models/rows.py), one row a *choice* (a state with one of its available actions):

    choices of state s          choice_start[s] … choice_start[s+1]−1,  by action choice_action[c]
    successors of choice c      target[row_start[c] … row_start[c+1]−1], with probability[…]
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import cached_property
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stltool.arguments import described, flag, mapping, require, texts, whole
from stltool.display import Card, Displayed, StateNames, counted, distinct, listed
from stltool.errors import ModelError, SettingsError, named, near_misses
from stltool.models.costs import Cost, fitted, read_costs
from stltool.models.fractions import (
    Fractions,
    Integers,
    Shares,
    doubles_of,
    floats,
    nearest,
    of_doubles,
    over_one,
    parsed,
)
from stltool.models.function import Function, Step
from stltool.models.intervals import Intervals
from stltool.models.normalize import rescale
from stltool.models.parameters import Parameter
from stltool.models.rows import READ_EXACTLY, ROW_TOLERANCE, Demand, Rows, Source, Stored, digest_arrays, hint, starts
from stltool.numbers import Exactable, NumberError, exact, number_text
from stltool.sizes import IntegerType, UnsignedType, integer_type, require_memory, require_numbered, unsigned_type
from stltool.streams import control_character

if TYPE_CHECKING:
    from scipy.sparse import csr_array

    from stltool.models.environment import BlackBox
    from stltool.models.sensing import Sensing

Floats: TypeAlias = NDArray[np.float64]

_SHOWN = 4  # initial states in a short description
_NAMED = 8  # initial states that are listed
_SHORT = 12  # characters of a number that is shown in full
_BLOCK = 1 << 14  # states
_FEW = 100_000  # row entries that are computed all at once


@dataclass(frozen=True, eq=False)
class GridLayout:
    """Where the states of a grid world lie on the floor: for pictures, and for naming a state by its cell.

    `column` and `row` (n_states,) count from the left and from the bottom.
    """

    width: int
    height: int
    column: NDArray[np.int64] = field(repr=False)
    row: NDArray[np.int64] = field(repr=False)


@dataclass(frozen=True, eq=False, repr=False)
class MDP(Displayed):
    """See the module's text; build one with `MDP.from_arrays`, `from_intervals`, `from_function`, `black_box` or
    `load_model`.

    source         where the rows come from (models/rows.py): all in memory, or computed on demand. `target`,
                   `probability`, `row_start` and the like contain all rows: a source on demand computes them on first
                   use
    initial        (n_states,) probabilities of the first state
    signals        name → (n_states,) reals
    labels         name → (n_states,) Booleans
    exact_initial  the exact values of the doubles `initial`, if they were given in fractions or decimals
    blackbox       if the probabilities are unknown: makes the environment that replaces them, from a generator and the
                   steps of an episode (None: not known). There are then no rows: `row_start` and `initial` are zero,
                   `target` and `probability` empty; `learn`, `estimate` and `sprt` work with the model
    state_names    a name for each state; names that repeat get the number of their state added: "x=0 (3)"
    notes          remarks on how the model was read, by subject: "normalize", or what a missing companion file would
                   define ("label", "signal")
    members        of a composition (models/composition.py): the models that it consists of, by name
    sensing        of a black box whose signals are real: its states are cells (models/sensing.py), and labels and
                   signals are empty; products read the task from what is sensed
    costs          name → what a step costs (models/costs.py)
    Raises ModelError, naming state and action, if a row is not a distribution, a state has no action, a value is not
    finite, or a shape does not fit.
    """

    source: Source
    initial: Floats
    signals: Mapping[str, Floats]
    labels: Mapping[str, NDArray[np.bool_]]
    action_names: tuple[str, ...]
    state_names: Sequence[str] | None = None
    layout: GridLayout | None = None
    name: str = "model"
    exact_initial: Shares | None = None
    blackbox: Callable[[np.random.Generator, int | None], BlackBox] | None = None
    notes: Mapping[str, str] = field(default_factory=dict)
    sensing: Sensing | None = None
    costs: Mapping[str, Cost] = field(default_factory=dict)
    members: Mapping[str, MDP] = field(default_factory=dict)

    def __post_init__(self) -> None:
        require(self.source, Source, "MDP's source", "make models by stl.MDP.from_arrays(...)")
        require(self.initial, np.ndarray, "MDP's initial", "make models by stl.MDP.from_arrays(...)")
        _validate(self)
        object.__setattr__(self, "costs", fitted(self.costs, self.source))
        if self.state_names is not None and not isinstance(self.state_names, StateNames):
            object.__setattr__(self, "state_names", distinct(self.state_names))
        for array in (self.initial, *self.signals.values(), *self.labels.values()):
            array.setflags(write=False)  # so that the digest stays valid

    # -------------------------------------------------------------------------------------------------- all rows

    @cached_property
    def rows(self) -> Rows:
        """All rows; SizeError before allocating more memory than is available."""
        return self.source.whole()

    @property
    def kinds(self) -> Rows | None:
        """Rows that represent all of them, by lengths and probabilities; None if nothing is known about them yet."""
        kinds = self.source.kinds
        return self.rows if kinds is None and "rows" in vars(self) else kinds

    def some_rows(self) -> Rows | Demand:
        """For callers that need some of the rows: those in memory, or a source's, computed on demand."""
        source = self.source
        few = _FEW if source.kinds is not None else READ_EXACTLY
        whole = not source.on_demand or "rows" in vars(self) or source.n_states * source.widest <= few
        return self.rows if whole else Demand(source)

    @property
    def choice_start(self) -> NDArray[np.int64]:
        return self.source.choice_start

    @property
    def choice_action(self) -> NDArray[np.int32]:
        return self.source.choice_action

    @property
    def row_start(self) -> NDArray[np.int64]:
        return self.rows.row_start

    @property
    def target(self) -> NDArray[np.int32]:
        return self.rows.target

    @property
    def probability(self) -> Floats:
        return self.rows.probability

    @property
    def intervals(self) -> Intervals | None:
        """If the probabilities are intervals: their ends. `uncertain` says whether they are, without computing rows."""
        return self.rows.intervals if self.uncertain else None

    @property
    def uncertain(self) -> bool:
        return self.source.uncertain

    # ------------------------------------------------------------------------------------------ sizes and names

    def _card(self) -> Card:
        counts = [counted(self.n_states, "state"), counted(self.n_actions, "action")]
        if self.blackbox is None and self.kinds is not None:
            counts.append(counted(self.n_transitions, "transition"))
        known = "a black box" if self.blackbox is not None else "intervals" if self.uncertain else None
        if self.parameters:
            known = f"depend on {listed(f'{one.name} in {one.domain}' for one in self.parameters)}"
        return Card(
            f"MDP {self.name}: {', '.join(counts)}",
            [
                {
                    "signals": listed(f"{x} in [{v.min():g}, {v.max():g}]" for x, v in self.signals.items()),
                    "labels": listed(f"{x} ({counted(int(v.sum()), 'state')})" for x, v in self.labels.items()),
                    "costs": listed(self.costs) if self.costs else None,
                },
                {
                    "starts in": self._starts(_SHOWN),
                    "actions": listed(self.action_names, 9),
                    "probabilities": known,
                },
            ],
        )

    @property
    def n_states(self) -> int:
        return self.source.n_states

    @property
    def n_choices(self) -> int:
        return self.source.n_choices

    @property
    def n_transitions(self) -> int:
        known = self.source.kinds is not None and "rows" not in vars(self)
        return self.source.n_transitions if known else len(self.rows.target)

    @property
    def n_actions(self) -> int:
        return len(self.action_names)

    @property
    def most_choices(self) -> int:
        """The largest number of actions of a state."""
        return self.source.most_choices

    @property
    def choice_type(self) -> IntegerType:
        """The dtype of a table of choices: indices within their state, negative where there is none."""
        return integer_type(self.most_choices - 1)

    @property
    def unsigned_choice_type(self) -> UnsignedType:
        """The dtype of choices none of which is missing."""
        return unsigned_type(self.most_choices - 1)

    def state_name(self, s: int) -> str:
        s = whole(s, "the model's state s", 0, self.n_states - 1)
        return self.state_names[s] if self.state_names is not None else str(s)

    def place(self, choice: int) -> str:
        """A choice in the user's names: "state (0,1), action N"."""
        choice = whole(choice, "the model's choice", 0, self.n_choices - 1)
        s = int(np.searchsorted(self.choice_start, choice, side="right")) - 1
        return f"state {self.state_name(s)}, action {self.action_names[self.choice_action[choice]]}"

    def initial_text(self) -> str:
        """The states that runs start in, with their probabilities if there are several; only the first of many."""
        return self._starts(_NAMED)

    def _starts(self, most: int) -> str:
        if self.blackbox is not None:
            return "an unknown state"
        states = np.flatnonzero(self.initial).tolist()
        if len(states) == 1:
            return self.state_name(states[0])
        shown = [(self.state_name(s), self._share_text(s)) for s in states[:most]]
        more = f", and {len(states) - len(shown)} more" if len(states) > len(shown) else ""
        if len(set(self.initial[states].tolist())) == 1:
            names = ", ".join(name for name, _ in shown)
            return f"{len(states)} states with probability {shown[0][1]} each: {names}{more}"
        return f"{len(states)} states: {', '.join(f'{name} with probability {share}' for name, share in shown)}{more}"

    def _share_text(self, s: int) -> str:
        text = number_text(self.exact_initial[s]) if self.exact_initial is not None else ""
        return text if 0 < len(text) <= _SHORT else f"{self.initial[s]:.6g}"

    def matrix(self) -> csr_array:
        """The transition probabilities as a scipy CSR array (n_choices, n_states), sharing memory."""
        from scipy.sparse import csr_array

        self.require_points()
        return csr_array((self.probability, self.target, self.row_start), shape=(self.n_choices, self.n_states))

    def require_points(self) -> None:
        """SettingsError if the probabilities are intervals or unknown: for everything that needs one distribution."""
        self.require_probabilities()
        if self.parameters:
            names = [parameter.name for parameter in self.parameters]
            raise SettingsError(
                f"the probabilities of {self.name} depend on {' and '.join(names)}, without a value; give one "
                f"(-p {names[0]}=…, in Python model.at({names[0]}=…)), or ask for all of them (check --vary, "
                "stl.parametric)"
            )
        if self.uncertain:
            raise SettingsError(
                f"the model's probabilities are intervals; use {named('check', 'stl.robust_check')}, or the ordinary "
                f"model inside them{named('nominal', ': model.nominal()')}"
            )

    def require_probabilities(self) -> None:
        """SettingsError if the probabilities are unknown: for a black box."""
        if self.blackbox is not None:
            raise SettingsError(
                f"the probabilities of {self.name} are unknown: it is a black box; use {named('learn', 'stl.learn')} "
                f"and {named('estimate', 'stl.estimate')}, or give a model with probabilities"
            )

    # ------------------------------------------------------------------------------------------ parameters

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The parameters on which the probabilities depend, and that have no value here; `at` gives them values."""
        ties = self.source.ties
        return ties.parameters if ties is not None else ()

    @cached_property
    def family(self) -> MDP | None:
        """The model as a function of its parameters: of those declared, of a grid's success probability otherwise.

        None if there are none. States and choices are the same; entries that are 0 here may be positive there.
        """
        if self.parameters:
            return self
        source = self.source.family
        return replace(self, source=source) if source is not None else None

    def require_family(self) -> MDP:
        """The family. SettingsError if there is none, or if the model is a black box."""
        self.require_probabilities()
        if self.family is None:
            raise SettingsError(
                f"the probabilities of {self.name} do not depend on parameters; declare them in the model "
                'file, [parameters] p = [0.5, 1], and write success = "p"; or MDP.from_arrays(..., parameters=...)'
            )
        return self.family

    def at(self, **values: Exactable) -> MDP:
        """The model where parameters have these values, such as `at(p=0.93)`; numbers as in model files.

        Raises SettingsError for unknown or missing parameters, ModelError for values outside their domains.
        """
        family = self.require_family()
        known = {parameter.name: parameter for parameter in family.parameters}
        for name in values:
            if name not in known:
                raise SettingsError(f"the model has no parameter {name}; {near_misses(name, known)}")
        missing = [name for name in known if name not in values]
        if missing:
            raise SettingsError(f"no value is given for {' and '.join(missing)}; write at({missing[0]}=…)")
        try:
            given = {name: known[name].require(exact(value)) for name, value in values.items()}
        except NumberError as error:
            raise SettingsError(f"a parameter's value: {error}") from None
        return replace(family, source=family.source.at(given))

    def within(self, **ranges: Sequence[Exactable]) -> MDP:
        """The family on parts of its domains, such as `within(p=(0.9, 0.95))`; parameters without a range keep theirs.

        Raises SettingsError for unknown parameters, ModelError for ranges outside their domains.
        """
        family = self.require_family()
        known = {parameter.name: parameter for parameter in family.parameters}
        for name, given in ranges.items():
            if name not in known:
                raise SettingsError(f"the model has no parameter {name}; {near_misses(name, known)}")
            try:
                lower, upper = map(exact, given)
            except (NumberError, TypeError, ValueError):
                raise SettingsError(f"the range of {name} is {described(given)}; give two numbers, (0.5, 1)") from None
            known[name] = known[name].within(lower, upper)
        return replace(family, source=family.source.narrowed(tuple(known.values())))

    def nominal(self) -> MDP:
        """The ordinary model with the nominal probabilities; without intervals the model itself.

        States, choices and actions are unchanged; entries whose probability must be 0 are left out.
        """
        return replace(self, source=self.source.nominal()) if self.uncertain else self

    def with_rows(self, **changes: Any) -> MDP:
        """The model with its rows in memory, some of them changed: `row_start`, `target`, `probability`, `exact`
        (Shares) or `intervals`."""
        rows = self.rows
        shares = Shares(rows.numerator, rows.denominator) if rows.given_exactly else None
        known = {
            "choice_start": self.choice_start, "choice_action": self.choice_action, "row_start": self.row_start,
            "target": self.target, "probability": self.probability, "exact": shares, "intervals": self.intervals,
        }  # fmt: skip
        return replace(self, source=Stored(**{**known, **changes}))

    @cached_property
    def _digest(self) -> str:
        sha = hashlib.sha256()
        self.source.digest_into(sha)
        columns = [
            ("initial", self.initial),
            *(("signal " + name, self.signals[name]) for name in sorted(self.signals)),
        ]
        digest_arrays(sha, [*columns, *(("label " + name, self.labels[name]) for name in sorted(self.labels))])
        sha.update("\0".join(self.action_names).encode())
        for name in sorted(self.costs):
            self.costs[name].digest_into(sha, name)
        return sha.hexdigest()

    def digest(self) -> str:
        """A SHA-256 of the content, action names included; for rows on demand, of what defines them."""
        return self._digest

    def starting_in(self, initial: int | str | ArrayLike) -> MDP:
        """The model whose runs start elsewhere: in a state, by index or name, or by a distribution (S,), as in
        `from_arrays`."""
        self.require_probabilities()
        start, shares = _initial(initial, self.n_states, self.state_names)
        exact_start = Shares(*over_one(shares)) if shares is not None else None
        return replace(self, initial=start, exact_initial=exact_start)

    @cached_property
    def initial_shares(self) -> Shares:
        """The probability of starting in each state, exactly."""
        if self.exact_initial is not None:
            return self.exact_initial
        return Shares(*of_doubles(self.initial, np.array([0, self.n_states])))

    def initial_share(self, s: int) -> Fraction:
        """The probability of starting in state s, exactly."""
        return self.initial_shares[s]

    @cached_property
    def initial_total(self) -> Fraction:
        """Σ initial, exactly."""
        shares = self.initial_shares
        return Fraction(int(shares.numerator.sum()), shares.denominator)

    @property
    def initial_defect(self) -> Fraction:
        """|Σ initial − 1|, exactly."""
        return abs(self.initial_total - 1)

    def exact(self) -> Fractions:
        """The exact probabilities: as given in fractions, or as the doubles are read (models/fractions.py)."""
        self.require_points()
        rows, start = self.rows, self.initial_shares
        return Fractions(rows.numerator, rows.denominator, start.numerator, start.denominator)

    # ------------------------------------------------------------------------------------------ building

    @classmethod
    def from_arrays(
        cls,
        transitions: ArrayLike | Iterable[Any],
        signals: Mapping[str, ArrayLike],
        initial: int | str | ArrayLike = 0,
        labels: Mapping[str, ArrayLike] | None = None,
        action_names: Sequence[str] | None = None,
        state_names: Sequence[str] | None = None,
        name: str = "model",
        *,
        normalize: bool = False,
        parameters: Mapping[str, Any] | None = None,
        costs: Mapping[str, Any] | None = None,
    ) -> MDP:
        """An MDP from one transition matrix per action.

        transitions   array (A, S, S), or a list of A matrices (S, S), dense or scipy sparse; row s of matrix a is the
                      distribution over successors. A row of zeros means that action a is not available in state s.
                      Entries may be Fractions or strings such as "2/5", which are kept exactly. Floats of fewer than 64
                      bits stand for their shortest decimals.
        signals       name → (S,) finite reals;  labels  name → (S,) Booleans
        initial       a state's index or name, or a distribution (S,)
        normalize     rescale rows, and the initial distribution, that miss 1 by at most 1/1000, so that they sum to 1
                      exactly (models/normalize.py); `notes` describes what that changed
        parameters    name → domain, such as {"p": (0.5, 1)} or {"p": {"domain": (0.5, 1), "value": 0.93}}; entries may
                      then be expressions that are linear in them, such as "(1-p)/3", at most one parameter a row
        costs         name → what a step costs: (S,) in each state, (S, A) for each action in it, (A, S, S) for each of
                      its successors; or their sum: {"states": (S,), "choices": (S, A)}
        """
        normalize = flag(normalize, "normalize")
        if parameters is not None:
            from stltool.models.family import from_expressions

            if normalize:
                raise SettingsError("rows that depend on parameters cannot be rescaled; leave out normalize")
            return from_expressions(
                transitions, parameters, signals=signals, initial=initial, labels=labels, action_names=action_names,
                state_names=state_names, name=name, costs=costs,
            )  # fmt: skip
        given = _given(transitions, "transitions")
        return cls._of_rows(
            _by_state(given), given, None, signals, initial, labels, action_names, state_names, name, costs, normalize
        )

    @classmethod
    def from_intervals(
        cls,
        lower: ArrayLike | Iterable[Any],
        upper: ArrayLike | Iterable[Any],
        signals: Mapping[str, ArrayLike],
        initial: int | str | ArrayLike = 0,
        labels: Mapping[str, ArrayLike] | None = None,
        action_names: Sequence[str] | None = None,
        state_names: Sequence[str] | None = None,
        name: str = "model",
        *,
        costs: Mapping[str, Any] | None = None,
    ) -> MDP:
        """An MDP whose probabilities are intervals [lower, upper], for `robust_check`.

        lower, upper  as `transitions` of `from_arrays`: array (A, S, S), or a list of A matrices (S, S). Entries with
                      upper end 0 cannot happen; a row of zeros in `upper` is an action that is not available.
        The rest as in `from_arrays`. Raises ModelError, naming state and action, unless 0 <= lower <= upper <= 1 and
        every row contains a distribution.
        """
        both = _given(lower, "lower ends"), _given(upper, "upper ends")
        rows = _by_state(both[1])
        exact = _exact_ends(*both, rows) if any(m.dtype == object for each in both for m in each) else None
        ends = Intervals(_aligned(_by_state(both[0]), rows), rows.data.astype(np.float64), exact)
        return cls._of_rows(rows, [], ends, signals, initial, labels, action_names, state_names, name, costs)

    @classmethod
    def from_family(cls, build: Callable[..., MDP], parameters: Mapping[str, Any]) -> MDP:
        """An MDP whose probabilities depend on parameters, from a function that makes its members.

        build       build(p=value) → MDP, called with Fractions: at the ends of the domains, and once in their middle.
                    Members have the same states and choices; their probabilities must be linear in the parameters,
                    which is checked in the middle, exactly, and each row may depend on one of them.
        parameters  as in `from_arrays`
        """
        from stltool.models.family import from_members

        return from_members(build, parameters)

    @classmethod
    def from_function(
        cls,
        states: int,
        actions: int | Sequence[str],
        step: Step,
        signals: Mapping[str, ArrayLike | Callable[[NDArray[np.int64]], ArrayLike]] | None = None,
        initial: int | str | ArrayLike = 0,
        labels: Mapping[str, ArrayLike | Callable[[NDArray[np.int64]], ArrayLike]] | None = None,
        *,
        available: ArrayLike | None = None,
        denominator: int | None = None,
        state_names: Sequence[str] | None = None,
        name: str = "model",
        costs: Mapping[str, Any] | None = None,
    ) -> MDP:
        """An MDP whose rows are computed by a function when needed, so that they are never all in memory.

        states        their number S;  actions  their number, or their names
        step          step(s, a) → (successors, probabilities): for int64 arrays s and a of shape (n,), arrays of shape
                      (n, k), in numpy or compiled by numba. Entries of probability 0 are dropped, entries with equal
                      successors added. It must always return the same for the same pair.
        denominator   probabilities are integers over it, and exact; None: they are doubles
        signals, labels   as in `from_arrays`, or functions of an array of states
        available     (S, A) Booleans: which actions a state has (default: all)
        initial, state_names, costs   as in `from_arrays`, without costs of successors

        A row is checked when it is computed: ModelError, naming state and action, if it is not a distribution.
        """
        n_states = whole(states, "from_function's states", least=1)
        names = _action_names(actions, "from_function's actions")
        _require_numbered(n_states, len(names))
        require_memory(40 * n_states, f"a model of {n_states} states", "use fewer states")
        if not callable(step):
            raise ModelError(f"step is {described(step)}; give a function of states and actions")
        if denominator is not None:
            denominator = whole(denominator, "from_function's denominator", 1, 2**53 - 1)
        given_names = _names(state_names, "state_names")
        start, exact_start = _initial(initial, n_states, given_names)
        has = _available(available, (n_states, len(names)))
        everywhere = np.ones(n_states * len(names), dtype=np.bool_) if has is None else has.ravel()
        return cls(
            Function(step, n_states, names, has, denominator),
            initial=start,
            exact_initial=Shares(*over_one(exact_start)) if exact_start is not None else None,
            **_columns(_of_states(signals, n_states), _of_states(labels, n_states), optional=True),
            action_names=names,
            state_names=given_names,
            name=_name(name),
            costs=read_costs(costs, n_states, len(names), everywhere, None),
        )

    @classmethod
    def black_box(
        cls,
        n_states: int,
        actions: int | Sequence[str],
        environment: Callable[[np.random.Generator], BlackBox],
        *,
        signals: Mapping[str, ArrayLike] | None = None,
        labels: Mapping[str, ArrayLike] | None = None,
        available: ArrayLike | None = None,
        state_names: Sequence[str] | None = None,
        name: str = "black box",
    ) -> MDP:
        """An MDP with unknown probabilities, behind a simulator of your own.

        actions       their number, or their names;  available  (S, A) Booleans: which a state has (default: all)
        environment   called with a numpy Generator; returns an object whose `reset()` and `step(i)` (the i-th available
                      action of the current state) return the index of a state. If it keeps nothing but that generator
                      between two episodes, return `stltool.models.environment.Environment(reset, step, generator)`, and
                      runs can be resumed. A simulator that takes many runs at once has an attribute `batch`,
                      `reset(n)` and `step(actions)` over arrays: `stltool.models.environment.Batched`
        signals, labels, state_names   as in `from_arrays`

        `learn`, `estimate`, `sprt` and `sample_run` work with it; what needs probabilities raises SettingsError.
        """
        n_states = whole(n_states, "n_states", least=1)
        if isinstance(actions, int | np.integer):
            _require_room(n_states, whole(actions, "actions", least=0))
        names = _action_names(actions, "black_box's actions")
        _require_room(n_states, len(names))
        if not callable(environment):
            raise ModelError(
                f"environment is {described(environment)}; give a function of a generator that returns one"
            )
        shape = (n_states, len(names))
        _require_numbered(*shape)
        given = _available(available, shape)
        if given is None:
            choice_start = np.arange(n_states + 1, dtype=np.int64) * len(names)
            choice_action = np.tile(np.arange(len(names), dtype=np.int32), n_states)
        else:
            choice_start, choice_action = starts(given.sum(axis=1)), np.nonzero(given)[1].astype(np.int32)
        return cls(
            Stored(
                choice_start,
                choice_action=choice_action,
                row_start=np.zeros(choice_start[-1] + 1, dtype=np.int64),
                target=np.empty(0, dtype=np.int32),
                probability=np.empty(0),
            ),
            initial=np.zeros(shape[0]),
            **_columns(signals, labels, optional=True),
            action_names=names,
            state_names=_names(state_names, "state_names"),
            name=_name(name),
            blackbox=lambda rng, _: environment(rng),
        )

    @classmethod
    def _of_rows(
        cls,
        rows: csr_array,
        given: list[Any],
        intervals: Intervals | None,
        signals: Mapping[str, ArrayLike],
        initial: int | str | ArrayLike,
        labels: Mapping[str, ArrayLike] | None,
        action_names: Sequence[str] | None,
        state_names: Sequence[str] | None,
        name: str,
        costs: Mapping[str, Any] | None,
        normalize: bool = False,
    ) -> MDP:
        """From rows (S·A, S), the actions of each state together; empty rows are unavailable actions.

        `given` are the matrices that the rows come from, for entries to be kept exactly.
        """
        n_states = rows.shape[1]
        n_actions = rows.shape[0] // max(n_states, 1)
        _require_numbered(n_states, n_actions)
        names = tuple(_names(action_names, "action_names") or (str(a) for a in range(n_actions)))
        given_names = _names(state_names, "state_names")
        if len(names) != n_actions:
            raise ModelError(f"{len(names)} action names for {n_actions} actions")
        available = np.diff(rows.indptr) > 0
        action = np.tile(np.arange(n_actions, dtype=np.int32), n_states)
        if not available.all():
            rows, action = rows[available], action[available]
        per_state = available.reshape(n_states, n_actions).sum(axis=1)
        row_start = rows.indptr.astype(np.int64)
        start, exact_start = _initial(initial, n_states, given_names)
        probability = rows.data if intervals is None else intervals.nominal(row_start)
        exact: Shares | None = None
        exact_initial, notes = (Shares(*over_one(exact_start)) if exact_start is not None else None), {}
        normalize = normalize and _are_positive(probability) and _are_positive(start[start != 0])  # else refused below
        if intervals is None and (normalize or exact_start is not None or any(m.dtype == object for m in given)):
            state = np.arange(n_states * n_actions)[available] // n_actions
            one_row = np.array([0, n_states])
            begin = exact_initial if exact_initial is not None else Shares(*of_doubles(start, one_row, normalize))
            shares = _exact_entries(rows, state, action, given, normalize)
            if normalize:
                known = given_names if given_names is not None else range(n_states)
                shares, done = rescale(
                    shares, row_start, lambda c: f"state {known[state[c]]}, action {names[action[c]]}"
                )
                first, started = rescale(
                    (begin.numerator, begin.denominator), one_row, lambda _: "the initial distribution"
                )
                begin = Shares(*first)
                probability, start = doubles_of(*shares), doubles_of(*first)
                notes["normalize"] = str(done + started)
            exact, exact_initial = Shares(*shares), begin
        target = rows.indices.astype(np.int32, copy=False)
        return cls(
            Stored(starts(per_state), action, row_start, target, probability, exact, intervals),
            initial=start,
            exact_initial=exact_initial,
            **_columns(signals, labels),
            action_names=names,
            state_names=given_names,
            name=_name(name),
            notes=notes,
            costs=read_costs(costs, n_states, n_actions, available, (row_start, target)),
        )


# ------------------------------------------------------------------------------------------- checks of input


def _require_room(n_states: int, n_actions: int) -> None:
    """SizeError, before anything is allocated, if a black box of that size would not fit into memory."""
    what = f"a black box of {n_states} states with {n_actions} actions"
    require_memory(n_states * (40 + 20 * n_actions) + 100 * n_actions, what, "use fewer states and actions")


def _action_names(actions: int | Sequence[str], what: str) -> tuple[str, ...]:
    if isinstance(actions, int | np.integer):
        n_actions = whole(actions, what, least=0)
        require_numbered(n_actions, "actions", "give fewer")
        actions = [str(a) for a in range(n_actions)]
    names = tuple(texts(actions, what))
    if not names:
        raise ModelError("the model has no actions; give their number or their names")
    return names


def _available(given: ArrayLike | None, shape: tuple[int, int]) -> NDArray[np.bool_] | None:
    if given is None:
        return None
    has = _booleans(given, "available", "give one Boolean for every state and action")
    if has.shape != shape:
        raise ModelError(f"available has shape {has.shape}, not {shape} (states, actions)")
    return has


def _of_states(columns: Any, n_states: int) -> Any:
    """Columns that are functions of states, evaluated."""
    if not isinstance(columns, Mapping):
        return columns
    return {key: column(np.arange(n_states)) if callable(column) else column for key, column in columns.items()}


def _columns(signals: object, labels: object, optional: bool = False) -> dict[str, Any]:
    """The signals and labels of a model, by name."""
    numbers = mapping(signals, "the model's signals", "{'x': [0.0, 0.5]}", optional=optional)
    truths = mapping(labels, "the model's labels", "{'A': [True, False]}", optional=True)
    return {
        "signals": {key: floats(numbers[key], f"signal {key}") for key in numbers},
        "labels": {key: _booleans(truths[key], f"label {key}", "make it a signal and compare it") for key in truths},
    }


def _names(given: object, what: str) -> Sequence[str] | None:
    if given is None or isinstance(given, StateNames):
        return given
    return tuple(texts(given, what))


def _name(given: object) -> str:
    require(given, str, "the model's name")
    return str(given)


def _exact_entries(
    rows: csr_array, state: NDArray[np.int64], action: NDArray[np.int32], given: list[Any], decimals: bool
) -> tuple[Integers, int]:
    """The rows' entries as integers over one denominator: as given in fractions, or as `of_doubles` reads doubles."""
    if not any(m.dtype == object for m in given):
        return of_doubles(rows.data, rows.indptr, decimals)
    as_fractions = np.array([m.dtype == object for m in given])[action]
    length = np.diff(rows.indptr)
    shares = np.empty(rows.nnz, dtype=object)
    if not as_fractions.all():
        doubles = rows[~as_fractions]
        numerator, denominator = of_doubles(doubles.data, doubles.indptr, decimals)
        shares[~np.repeat(as_fractions, length)] = [Fraction(int(n), denominator) for n in numerator]
    entries = np.flatnonzero(np.repeat(as_fractions, length))
    s, a = np.repeat(state, length)[entries], np.repeat(action, length)[entries]
    shares[entries] = [given[i][j, k] for i, j, k in zip(a, s, rows.indices[entries], strict=True)]
    return over_one(shares.tolist())


def _exact_ends(lower: list[Any], upper: list[Any], rows: csr_array) -> tuple[Shares, Shares]:
    """The ends of the entries of `rows`, exactly: as given in fractions; of doubles, the shortest decimals."""
    n_actions = len(upper)
    s, a = np.divmod(np.repeat(np.arange(rows.shape[0]), np.diff(rows.indptr)), n_actions)
    entries = list(zip(a.tolist(), s.tolist(), rows.indices.tolist(), strict=True))
    ends = ([exact(given[i][j, k]) for i, j, k in entries] for given in (lower, upper))
    first, second = (Shares(*over_one(each)) for each in ends)
    return first, second


def _given(matrices: ArrayLike | Iterable[Any], what: str) -> list[Any]:
    """One matrix (S, S) per action, each as `_matrix` reads it."""
    given = [_matrix(m, a, what) for a, m in enumerate(_matrices(matrices, what))]
    if not given:
        raise ModelError(f"{what} contain no action; give one (S, S) matrix per action")
    n_states = given[0].shape[1]
    for a, matrix in enumerate(given):
        if matrix.shape != (n_states, n_states):
            raise ModelError(f"{what} of action {a} have shape {matrix.shape}, not ({n_states}, {n_states})")
    return given


def _by_state(given: list[Any]) -> csr_array:
    """Rows (S·A, S) in doubles, the actions of a state one after another."""
    from scipy import sparse

    n_states, n_actions = given[0].shape[1], len(given)
    parts = [_canonical(m) for m in given]
    n = sum(part.nnz for part in parts)
    start = np.zeros(n_states * n_actions + 1, dtype=np.int64)
    target, data = np.empty(n, dtype=np.int32 if n < 2**31 else np.int64), np.empty(n)  # scipy needs one dtype for both
    for lo in range(0, n_states, _BLOCK):  # so that little is in memory twice
        hi = min(lo + _BLOCK, n_states)
        order = np.arange((hi - lo) * n_actions).reshape(n_actions, hi - lo).T.ravel()
        block = sparse.vstack([part[lo:hi] for part in parts], format="csr")[order]
        here, end = slice(lo * n_actions + 1, hi * n_actions + 1), int(start[lo * n_actions])
        start[here] = end + block.indptr[1:]
        target[end : end + block.nnz], data[end : end + block.nnz] = block.indices, block.data
    return sparse.csr_array((data, target, start.astype(target.dtype)), shape=(n_states * n_actions, n_states))


def _canonical(matrix: Any) -> csr_array:
    """Successors in ascending order, once each, without zeros. A dense matrix is converted by way of COO."""
    from scipy import sparse

    if not sparse.issparse(matrix):
        values = matrix.astype(np.float64, copy=False)
        there = values != 0
        return sparse.csr_array((values[there], np.nonzero(there)[1], starts(there.sum(axis=1))), shape=matrix.shape)
    rows = sparse.csr_array(matrix)
    if not rows.has_canonical_format or not rows.data.all():
        rows = rows.copy()
        rows.sum_duplicates()
        rows.eliminate_zeros()
    return rows


def _aligned(lower: csr_array, upper: csr_array) -> Floats:
    """The lower end of every entry of `upper`."""
    if lower.shape != upper.shape:
        raise ModelError(
            f"lower ends are of {lower.shape[0] // lower.shape[1]} actions and {lower.shape[1]} states, upper ends of "
            f"{upper.shape[0] // upper.shape[1]} actions and {upper.shape[1]} states"
        )
    n_states = upper.shape[1]
    places, known = (np.repeat(np.arange(m.shape[0]), np.diff(m.indptr)) * n_states + m.indices for m in (lower, upper))
    entry = np.searchsorted(known, places)
    without = np.flatnonzero(np.append(known, -1)[entry] != places)
    if without.size:
        row, successor = divmod(int(places[without[0]]), n_states)
        s, a = divmod(row, upper.shape[0] // n_states)
        raise ModelError(
            f"state {s}, action {a}: the lower end {lower.data[without[0]]:.12g} to state {successor} is above the "
            "upper end 0"
        )
    ends = np.zeros(len(known))
    ends[entry] = lower.data
    return ends


def _matrices(matrices: ArrayLike | Iterable[Any], what: str) -> Iterable[Any]:
    shape = getattr(matrices, "shape", None)  # also scipy's matrices
    if shape is not None and len(shape) != 3:
        raise ModelError(f"{what} have shape {shape}; give an array (A, S, S) or a list of matrices")
    try:
        return list(matrices)  # type: ignore[arg-type]
    except TypeError:
        raise ModelError(f"{what} must be an array (A, S, S) or a list of (S, S) matrices") from None


def _matrix(matrix: Any, action: int, what: str) -> Any:
    """One action's matrix: scipy sparse or dense doubles, or an object array of Fractions if it contains any."""
    from scipy.sparse import issparse

    try:
        if np.iscomplexobj(matrix):
            raise TypeError
        if issparse(matrix):
            return nearest(matrix)
        array = np.asarray(matrix)
        array = parsed(array) if array.dtype.kind in "OU" else nearest(array)
        array.astype(np.float64)  # detects values without a nearby double
    except NumberError as error:
        raise ModelError(f"{what} of action {action} are not numbers: {error}") from None
    except (TypeError, ValueError, OverflowError):
        raise ModelError(f"{what} of action {action} are not numbers") from None
    if array.ndim != 2:
        raise ModelError(f"{what} of action {action} have shape {array.shape}; give a matrix (S, S)")
    return array


def _are_positive(values: Floats) -> bool:
    return bool(((values > 0) & (values <= 2)).all())


def _booleans(values: ArrayLike, what: str, otherwise: str) -> NDArray[np.bool_]:
    try:
        array = np.asarray(values)
    except ValueError:
        raise ModelError(f"{what} is not a list with one value per state") from None
    if array.dtype.kind not in "biuf" or not np.isin(array, (0, 1)).all():
        raise ModelError(f"{what} has values other than true and false; {otherwise}")
    return array.astype(np.bool_)


def _initial(
    initial: int | str | ArrayLike, n_states: int, state_names: Sequence[str] | None
) -> tuple[Floats, list[Fraction] | None]:
    """The initial distribution in doubles, and in Fractions if given so."""
    if isinstance(initial, str):
        given = state_names or ()
        names = given if isinstance(given, StateNames) else distinct(given)
        if initial not in names:
            same = [names[s] for s, name in enumerate(given) if name == initial]
            hint = f"several states have this name: {', '.join(same)}" if same else near_misses(initial, names)
            raise ModelError(f"there is no initial state {initial!r}; {hint}")
        initial = list(names).index(initial)
    if isinstance(initial, bool):
        raise ModelError(f"the initial state is {initial}; give its index, its name, or a distribution (S,)")
    if isinstance(initial, int | np.integer):
        if not 0 <= initial < n_states:
            raise ModelError(f"the initial state {described(initial)} is not one of 0 … {n_states - 1}")
        point = np.zeros(n_states)
        point[initial] = 1.0
        return point, None
    array = np.asarray(initial)
    if array.dtype.kind in "OU":
        try:
            shares = [exact(value) for value in array.ravel().tolist()]
            return np.array(shares, dtype=np.float64), shares
        except (NumberError, OverflowError) as error:
            raise ModelError(f"the initial distribution does not contain numbers: {error}") from None
    return floats(array, "the initial distribution"), None


def _require_numbered(n_states: int, n_actions: int) -> None:
    if n_states < 1:
        raise ModelError("the model has no states")
    require_numbered(n_states, "states", "coarsen the grid, or use a part of the model")
    require_numbered(n_actions, "actions", "give fewer")


def _validate(m: MDP) -> None:
    _require_numbered(m.n_states, m.n_actions)
    if m.state_names is not None and len(m.state_names) != m.n_states:
        raise ModelError(f"{len(m.state_names)} state names for {m.n_states} states")
    if len(set(m.action_names)) != m.n_actions:
        raise ModelError(f"action names repeat: {', '.join(m.action_names)}")
    for name in (*m.action_names, *m.signals, *m.labels, *m.costs):
        if control := control_character(name):
            raise ModelError(f"the name {name!r} has the control character {control}; rename it")
    for kind, named_so in (("signal", m.signals), ("cost", m.costs)):
        if any(not name.strip() for name in named_so):
            raise ModelError(f"the name of a {kind} is empty; give it one")
    for name, values in (*m.signals.items(), *m.labels.items()):
        if values.shape != (m.n_states,):
            raise ModelError(f"{name} has shape {values.shape}; give one value for each of the {m.n_states} states")
        bad = np.flatnonzero(~np.isfinite(values))
        if bad.size:
            raise ModelError(f"signal {name} is {values[bad[0]]} in state {m.state_name(bad[0])}; it must be finite")
    both = sorted(set(m.signals) & set(m.labels))
    if both:
        raise ModelError(f"{both[0]} is the name of both a signal and a label; rename one of them")
    if m.blackbox is None:
        _validate_distribution(m.initial, m.n_states)
    without = np.flatnonzero(np.diff(m.choice_start) == 0) if not m.source.on_demand else np.empty(0)
    if without.size:
        raise ModelError(
            f"state {m.state_name(without[0])} has no action; give it one that stays (probability 1 to itself)"
        )
    if m.blackbox is None:
        m.source.require_distributions(m.place, m.state_name)
    elif len(m.row_start) != m.n_choices + 1 or m.row_start.any() or m.n_transitions or m.initial.any():
        raise ModelError("a black box has no rows and no initial distribution; make one with MDP.black_box")


def _validate_distribution(initial: Floats, n_states: int) -> None:
    if initial.shape != (n_states,):
        raise ModelError(f"the initial distribution has shape {initial.shape}, not ({n_states},)")
    if not np.isfinite(initial).all() or (initial < 0).any():
        raise ModelError("the initial distribution has values that are not probabilities")
    if abs(initial.sum() - 1) > ROW_TOLERANCE:
        raise ModelError(f"the initial distribution sums to {initial.sum():.12g}, not 1{hint(initial.sum())}")
