"""A policy over a product: which available action to take at (t, s, q), saved and loaded without pickle.

Choices are indices within their state: i is its i-th available action (in a grid world simply the i-th action). The
policies of `check` are stored by step and only where choices matter (`Choices`); others are dense tables, whose dtype
and shape define their form, with S model states, Q automaton states and at most C choices:

    (S, Q) integers    stationary              (h, S, Q) integers    one table a step
    (S, Q, C) float64  stationary mixture      (h, S, Q, C) float64  mixture a step

Integers are int16, or wider if a state has more choices (`MDP.choice_type`). A negative entry means that no action is
defined. A policy is bound to formula and model by digests; for a model with intervals, by the digest of its nominal
model, so that a policy made for one can be evaluated on the other. Over a joint product Q is the number of states of
the joint automaton: they determine the step, and the policy serves each of the tasks.
"""

from __future__ import annotations

import csv
import io
import json
import math
import warnings
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stltool import written
from stltool.arguments import path as path_of
from stltool.arguments import require, whole
from stltool.arrays import open_arrays
from stltool.asked import Asked, Situation, Situations
from stltool.automata import Encoding
from stltool.choices import Choices, Form, Rules, Table, Through
from stltool.display import Card, Displayed
from stltool.errors import FileError, InexactEncodingWarning, PolicyError, StlToolError, near_misses
from stltool.files import (
    atomic_file,
    begins,
    read_text,
    require_folder,
    require_own,
    require_replaceable,
    write_atomically,
)
from stltool.layered import LayeredWriter, is_layered, read_header, read_layers
from stltool.numbers import double
from stltool.product import Both, JointProduct, Product, build_joint_product, build_product, joined
from stltool.sizes import require_memory

FORMAT = "stltool-policy-2"
_TEXT = (".csv", ".json")
_LONGEST_HEADER = 1 << 24
_PARTS = {"first": np.int64, "last": np.int64, "start": np.int64, "keys": np.int64, "bits": np.uint64, "choice": None}
"""The arrays of `Choices` in a file, and their dtypes; choices have the smallest unsigned one."""
_SIGNAL_TOLERANCE = 1e-6  # published tables have few digits


@dataclass(frozen=True)
class Binding:
    """The task and model that a policy belongs to, as in its file's header.

    `tasks` are all tasks of the joint product that it was made for, `formula` first.
    """

    formula: str
    encoding: str
    model: str
    model_digest: str
    automaton_digest: str
    action_names: tuple[str, ...]
    tasks: tuple[str, ...] = ()

    @classmethod
    def of(cls, product: Product | JointProduct) -> Binding:
        together = [str(task.formula) for task in product.tasks] if isinstance(product, JointProduct) else []
        return cls(
            formula=together[0] if isinstance(product, JointProduct) else str(product.formula),
            encoding=_encoding_of(product),
            model=product.model.name,
            model_digest=product.model.nominal().digest(),  # intervals do not affect whether a policy fits
            automaton_digest=product.automaton.digest(),
            action_names=product.model.action_names,
            tasks=tuple(together),
        )

    def require(self, product: Product, what: str) -> None:
        """PolicyError, naming both sides, unless this binding is to that product's task and model."""
        here = Binding.of(product)
        known = self.tasks or (self.formula,)
        if here.formula not in known:
            raise PolicyError(
                f"{what} is for the task {' and the task '.join(known)}, not for {here.formula}; "
                "check it against its own task, or learn one for this"
            )
        if self.model_digest != here.model_digest:
            raise PolicyError(
                f"{what} is for the model {self.model} ({self.model_digest[:12]}), not for {here.model} "
                f"({here.model_digest[:12]}); check it against its own model, or learn one for this"
            )


class Policy(Displayed):
    """See the module's text. Raises PolicyError if the table, or another form, does not fit the product.

    `home` is the product whose automaton states index the table. A policy for the same task and model can be checked on
    a product with another encoding, and one for a joint product on the product of each of its tasks: `on` translates
    it.
    """

    def __init__(self, product: Product | JointProduct, table: NDArray[Any] | Form) -> None:
        require(product, (Product, JointProduct), "Policy's product")
        self.home = product
        if isinstance(table, Form):
            self.form: Form = table
            return
        try:
            given = np.asarray(table)
        except ValueError:
            raise PolicyError(
                "the policy's table is not an array: its rows have unequal lengths; give one row per state"
            ) from None
        self.form = Table(_checked(product, given))

    def _card(self) -> Card:
        home, form = self.home, self.form
        silent = int((form.table < 0).sum()) if isinstance(form, Table) else 0
        if isinstance(form, Choices | Rules | Asked):
            held = repr(form).partition(": ")[2]
        else:
            held = f"a table of {' x '.join(map(str, self._shape()))}"
        if isinstance(home, JointProduct):
            task = "; ".join(str(each.formula) for each in home.tasks)
        else:
            task = f"{home.task_name} := {home.formula}"
        encoding = home.automaton.encoding
        return Card(
            f"Policy: {self.kind}, {held}",
            [
                {"task": task},
                {"model": home.model.name, "encoding": encoding, "entries without action": silent or None},
            ],
        )

    @cached_property
    def binding(self) -> Binding:
        """Computed on demand: a large model's digest takes a while."""
        return Binding.of(self.home)

    def on(self, product: Product) -> tuple[Product, Policy]:
        """This policy and a product to evaluate it on: `product`, or its join with the policy's own automaton."""
        require(product, Product, "the policy's product")
        if product is self.home:
            return product, self
        self.binding.require(product, "the policy")
        if self.binding.automaton_digest == product.automaton.digest():
            return product, self
        both, memory = joined(product, self.home)
        return both, Policy(both, Through(self.form, memory))

    @property
    def deterministic(self) -> bool:
        return self.form.deterministic

    @property
    def stationary(self) -> bool:
        return self.form.stationary

    @property
    def kind(self) -> str:
        """In words, for reports."""
        time = "stationary" if self.stationary and not isinstance(self.home, JointProduct) else "time-dependent"
        return f"{time}, {'deterministic' if self.deterministic else 'mixed'}"

    def at(self, t: int, s: ArrayLike, q: ArrayLike) -> NDArray[Any]:
        """The choices in pairs of model states s and automaton states q at step t.

        s, q (n,) integers. Returns (n,) int64 choices, negative where none is defined; for a mixture (n, C) weights.
        """
        t = whole(t, "the policy's step t", 0, None if self.stationary else self.home.horizon - 1)
        places = []
        for given, what, n in zip((s, q), ("model states", "automaton states"), self.home.shape, strict=True):
            array = np.atleast_1d(np.asarray(given))
            if array.ndim != 1 or array.dtype.kind not in "iu" or (array < 0).any() or (array >= n).any():
                raise PolicyError(f"the policy's {what} must be integers from 0 to {n - 1}; give a number or a list")
            places.append(array.astype(np.int64))
        if len(places[0]) != len(places[1]) and 1 not in map(len, places):
            raise PolicyError(
                f"the policy's at got {len(places[0])} model states and {len(places[1])} automaton states; give "
                "equally many"
            )
        return self.form.at(t, *np.broadcast_arrays(*places))

    def row(self, t: int) -> NDArray[Any]:
        """Step t as a dense table: (S, Q) choices or (S, Q, C) weights."""
        t = whole(t, "the policy's step t", 0, None if self.stationary else self.home.horizon - 1)
        return self.form.row(t)

    @property
    def table(self) -> NDArray[Any]:
        """The whole policy as a dense table (see the module's text), computed on demand.

        Raises SizeError before allocating more memory than is available.
        """
        if isinstance(self.form, Table):
            return self.form.table
        if self.stationary:
            return self.form.row(0)
        shape = self._shape()
        what = f"a dense table of {' x '.join(map(str, shape))}"
        require_memory(8 * math.prod(shape), what, "read parts of it with at or row")
        rows = [self.form.row(t) for t in range(self.home.horizon)]
        return np.stack(rows) if rows else np.zeros(shape, dtype=self.home.model.choice_type)

    def _shape(self) -> tuple[int, ...]:
        steps = () if self.stationary else (self.home.horizon,)
        return (*steps, *self.home.shape, *(() if self.deterministic else (self.home.model.most_choices,)))

    def save(self, path: str | Path) -> None:
        """Write the policy atomically: as .npz, as .csv or .json, or as uncompressed .policy.

        .csv and .json are text in the names of model and task, for people and other programs (stltool/written.py): the
        rules for all situations that runs can come to. SizeError if these are too many. A .policy file contains a
        policy found by `check`, and is read through a memory map (stltool/layered.py).
        """
        path = path_of(path, "save's path")
        require_policy_file(path)
        self._require_home()
        if path.suffix.lower() in _TEXT:
            write_atomically(path, written.as_text(self.home, self.form, self._facts(), path.suffix.lower()[1:]))
            return
        if path.suffix.lower() == ".policy":
            if not isinstance(self.form, Choices):
                raise PolicyError(f"{path}: .policy files are for policies found by check; save this one as .npz")
            with atomic_file(path) as file:
                writer = LayeredWriter(file, layered_header(self.home))
                for layer in self.form.layers[::-1]:
                    writer.add(layer)
                writer.finish()
            return
        header = json.dumps({"format": FORMAT, **asdict(self.binding)})
        buffer = io.BytesIO()
        arrays: dict[str, Any] = self.form.arrays() if isinstance(self.form, Choices) else {"table": self.table}
        np.savez_compressed(buffer, header=np.frombuffer(header.encode("utf-8"), dtype=np.uint8), **arrays)
        write_atomically(path, buffer.getvalue())

    def _require_home(self) -> None:
        """PolicyError if what the policy remembers could not be made again from a file: nobody could load it."""
        home = self.home
        if isinstance(home, JointProduct) or not isinstance(home.automaton.memory, Both):
            return
        try:
            again = _built(home, self.binding.encoding)
        except StlToolError:
            again = None
        if again is None or again.automaton.digest() != home.automaton.digest():
            raise PolicyError(
                "the policy remembers more than its task, from several tasks or another model, and could not be loaded "
                "again; save the policy that it was made from"
            )

    def _facts(self) -> dict[str, list[str]]:
        """What a policy as text says about the whole."""
        binding = self.binding
        return {
            "task": list(binding.tasks or (binding.formula,)),
            "encoding": [binding.encoding],
            "model": [binding.model],
            "model digest": [binding.model_digest],
            "automaton digest": [binding.automaton_digest],
        }

    @classmethod
    def _of_text(cls, path: Path, product: Product, text: str) -> Policy:
        """A policy as text, for this product; see `load`."""
        found = written.read(path, text, path.suffix.lower()[1:])
        here = Binding.of(product)
        tasks = tuple(found.facts.get("task", (here.formula,)))
        binding = Binding(
            formula=tasks[0],
            encoding=found.fact("encoding") or here.encoding,
            model=found.fact("model") or here.model,
            model_digest=found.fact("model digest") or here.model_digest,
            automaton_digest=found.fact("automaton digest") or "",
            action_names=here.action_names,
            tasks=tasks if len(tasks) > 1 else (),
        )
        home = _home_of(path, product, binding)
        return cls(home, written.form_of(path, home, found, product.definitions))

    @classmethod
    def load(cls, path: str | Path, product: Product) -> Policy:
        """Read a policy for this product; PolicyError names both sides if it belongs to another.

        Policies as text (.csv, .json) may be edited or written by hand: faults are told with their lines.
        """
        path = path_of(path, "Policy.load's path")
        require(product, Product, "Policy.load's product")
        if path.suffix.lower() in _TEXT:
            return cls._of_text(path, product, read_text(path, "policy file"))
        layered = is_layered(path)
        try:
            if layered:
                header = read_header(path)
                for key in ("choice", "shape", "horizon"):
                    header.pop(key, None)
            else:
                with open_arrays(path, "policy file") as archive:
                    header = json.loads(archive.read("header", np.uint8, (None,), _LONGEST_HEADER).tobytes())
                    if set(archive.names) - {"header"} not in ({"table"}, set(_PARTS)):
                        raise ValueError
            if header.pop("format") != FORMAT:
                raise ValueError
            header["action_names"] = tuple(header["action_names"])
            header["tasks"] = tuple(header.get("tasks", ()))
            binding = Binding(**header)
            texts = (*binding.action_names, binding.formula, *binding.tasks, binding.encoding, binding.model)
            if not all(isinstance(text, str) for text in (*texts, binding.model_digest, binding.automaton_digest)):
                raise ValueError
        except FileError:
            raise
        except Exception:  # a damaged archive fails in many ways, all caused by the file
            raise PolicyError(
                f"{path}: not a policy file of this version ({FORMAT}); write one with check --save-policy, "
                "learn --out or Policy.save"
            ) from None
        home = _home_of(path, product, binding)
        try:
            if layered:
                kind = home.model.choice_type
                return cls(home, _required(home, Choices(home.shape, home.horizon, read_layers(path)[1], kind)))
            table = _arrays(path, home)
            if "table" in table:
                return cls(home, table["table"])
            return cls(home, _required(home, _of_arrays(home, table)))
        except PolicyError as error:
            raise PolicyError(f"{path}: {str(error).removeprefix(f'{path}: ')}") from None

    @classmethod
    def from_function(
        cls,
        product: Product,
        function: Callable[[Situation], Any] | Callable[[Situations], Any],
        *,
        batched: bool = False,
        mixed: bool | None = None,
    ) -> Policy:
        """The policy that does what a function answers: a network, a planner, a rule of thumb.

        function  gets a `Situation` (step, state, signals, labels, what is remembered, the available actions) and
                  returns an action: its name, or its number among the model's `action_names`; None: no action
        batched   it gets `Situations` instead, arrays of n runs after the same number of steps, and returns n actions:
                  for networks, which answer many at once
        mixed     it returns weights that sum to 1: a mapping from actions, or an array (A,) over all of the model's;
                  with `batched` (n, A). None: as its first answer is; for a black box, False

        It is asked once in every undecided situation that runs under it reach, when that is first needed, and answers
        are remembered. Raises PolicyError, naming the situation, for an answer that is not an available action, and for
        an exception in the function.
        """
        return cls(product, Asked(product, function, batched, mixed))

    @classmethod
    def from_q_table(cls, path: str | Path, product: Product) -> Policy:
        """The greedy policy of a Q-table in CSV, ties uniform.

        First column: `[signals… registers…]` in the order of the model's signals and the automaton's registers (the
        flags); then a column per action, by name. States without a row have no preference: uniform. If the product's
        automaton has no flags, the policy uses the flags of [Wang24], and `check` evaluates it exactly.
        """
        path = path_of(path, "Policy.from_q_table's path")
        require(product, Product, "Policy.from_q_table's product")
        names, rows = _read_q_table(path)
        product = with_flags(product)
        model, automaton = product.model, product.automaton
        if sorted(names) != sorted(model.action_names):
            raise PolicyError(
                f"{path}: the columns are {', '.join(names)}; the model's actions are {', '.join(model.action_names)}"
            )
        keys, values = rows
        n_signals, n_registers = len(model.signals), len(automaton.register_names)
        if keys.shape[1] != n_signals + n_registers:
            raise PolicyError(
                f"{path}: the index has {keys.shape[1]} numbers; it needs {n_signals} signals "
                f"({', '.join(model.signals)}) and {n_registers} registers ({', '.join(automaton.register_names)})"
            )
        signals = np.array(list(model.signals.values())).reshape(n_signals, model.n_states).T
        s = _find_rows(path, keys[:, :n_signals], signals, "state")
        q = _find_rows(path, keys[:, n_signals:], automaton.registers.astype(np.float64), "automaton state")
        if len(np.unique(s * automaton.n_states + q)) < len(s):
            raise PolicyError(f"{path}: two rows are for the same state")
        q_values = np.zeros((*product.shape, model.n_actions))
        q_values[s, q] = values[:, [names.index(name) for name in model.action_names]]
        return greedy(product, q_values)


def require_door(caller: str, product: object, policy: object = None) -> None:
    """ArgumentError unless the arguments are a product, and a policy or None, as for most questions."""
    require(product, Product, f"{caller}'s product")
    require(policy, Policy, f"{caller}'s policy", optional=True)


def layered_header(product: Product | JointProduct) -> dict[str, Any]:
    """The first line of a layered policy file."""
    kind = np.dtype(product.model.unsigned_choice_type).name
    sizes = {"choice": kind, "shape": list(product.shape), "horizon": product.horizon}
    return {"format": FORMAT, **asdict(Binding.of(product)), **sizes}


def _home_of(path: Path, product: Product, binding: Binding) -> Product | JointProduct:
    """The product that a file's policy was made on; PolicyError, naming both sides, if it is for something else."""
    binding.require(product, f"{path}: this policy")
    try:
        home = _home(product, binding.encoding) if not binding.tasks else _joint_home(product, binding)
    except StlToolError as error:
        raise PolicyError(f"{path}: a damaged policy file: {error}") from None
    if binding.automaton_digest and home.automaton.digest() != binding.automaton_digest:
        raise PolicyError(
            f"{path}: this policy was made with another automaton of the same task "
            f"({binding.automaton_digest[:12]}, here {home.automaton.digest()[:12]}); learn it again"
        )
    return home


def require_policy_file(path: str | Path) -> None:
    """An error, before the computation, if a policy could not be saved after it."""
    path = Path(path)
    require_replaceable(path)
    if path.suffix.lower() not in (".npz", ".policy", *_TEXT):
        raise PolicyError(f"{path}: policies are saved as .npz, .csv, .json or .policy; use one of these extensions")
    require_own(path, "policy", _is_policy)
    require_folder(path.parent)


def _is_policy(path: Path) -> bool:
    """Whether a file is a policy of ours, of this version or another."""
    if (
        is_layered(path)
        or begins("# format", written.FORMAT)(path)
        or begins(f'{{"format": "{written.FORMAT}"', "")(path)
    ):
        return True
    try:
        with open_arrays(path, "policy file") as archive:
            found = json.loads(archive.read("header", np.uint8, (None,), _LONGEST_HEADER).tobytes())["format"]
        return bool(found.rpartition("-")[0] == FORMAT.rpartition("-")[0])
    except Exception:  # other files, and damaged ones, fail in many ways
        return False


def silence(product: Product, s: int, q: int, t: int | None) -> PolicyError:
    """The error for a policy that defines no action in a reachable pair, in the user's names."""
    where = product.describe(s * product.automaton.n_states + q, t)
    return PolicyError(f"the policy defines no action at {where}, which is reachable under it; give it an action there")


def load_policy(path: str | Path, product: Product) -> Policy:
    """Read a policy file: `.npz`, `.csv`, `.json` or `.policy` as saved by `Policy.save`; or a Q-table in `.csv`."""
    path = path_of(path, "load_policy's path")
    require(product, Product, "load_policy's product")
    if path.suffix.lower() == ".csv" and not written.is_rules(read_text(path, "policy file")):
        return Policy.from_q_table(path, product)
    return Policy.load(path, product)


def greedy(product: Product, q_values: NDArray[np.float64]) -> Policy:
    """The stationary policy that is uniform over the best available actions; `q_values` (S, Q, A)."""
    model = product.model
    weights = np.zeros((*product.shape, int(np.diff(model.choice_start).max())))
    for s in range(model.n_states):
        values = q_values[s][:, model.choice_action[model.choice_start[s] : model.choice_start[s + 1]]]
        best = values == values.max(axis=1, keepdims=True)
        weights[s, :, : values.shape[1]] = best / best.sum(axis=1, keepdims=True)
    return Policy(product, weights)


def _home(product: Product, encoding: str) -> Product:
    """The product of the same model and task in a policy's own encoding; as memory, an approximation is good enough."""
    if _encoding_of(product) == encoding:
        return product
    if encoding.count("+") == 1:  # a policy of one encoding that was used on the product of another
        left, _, right = encoding.partition("+")
        return joined(_home(product, left), _home(product, right))[0]
    return _built(product, encoding)


def _built(product: Product, encoding: str) -> Product:
    """As `_home`, made from model and formula alone."""
    if encoding.count("+") == 1:  # a policy of one encoding that was used on the product of another
        left, _, right = encoding.partition("+")
        return joined(_built(product, left), _built(product, right))[0]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", InexactEncodingWarning)
        return build_product(product.model, product.formula, cast(Encoding, encoding))


def _encoding_of(product: Product | JointProduct) -> str:
    """The encoding of what a policy on this product remembers: "exact+paper" if that is of two automata."""
    if isinstance(product, Product) and isinstance(product.automaton.memory, Both):
        return f"{product.automaton.memory.left.encoding}+{product.automaton.memory.right.encoding}"
    return product.automaton.encoding


def _joint_home(product: Product, binding: Binding) -> JointProduct:
    """The joint product of the tasks that a policy was made for."""
    from stltool.logic.parser import parse  # lark is slow to load

    tasks = {f"task {i}": parse(text) for i, text in enumerate(binding.tasks, start=1)}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", InexactEncodingWarning)
        return build_joint_product(product.model, tasks, cast(Encoding, binding.encoding))


def with_flags(product: Product) -> Product:
    """The product itself if its automaton has flags, else the one with the paper's flags."""
    return product if product.automaton.register_names else _home(product, "paper")


# --------------------------------------------------------------------------------------------------- checks


def _checked(product: Product | JointProduct, table: NDArray[Any]) -> NDArray[Any]:
    n_choices = np.diff(product.model.choice_start)
    most = product.model.most_choices
    base, timed = product.shape, (product.horizon, *product.shape)
    if table.dtype.kind in "iu":
        if table.shape not in (base, timed):
            raise PolicyError(f"the policy's table has shape {table.shape}; give {base} or {timed}")
        too_large = table >= n_choices[:, None]
        if too_large.any():
            where = tuple(int(i) for i in np.argwhere(too_large)[0])
            s = where[-2]
            raise PolicyError(
                f"the policy takes choice {table[where]} in state {product.model.state_name(s)}, "
                f"which has {n_choices[s]}, counted from 0"
            )
        kept = np.maximum(table, -1) if table.dtype.kind == "i" else table
        return np.ascontiguousarray(kept, dtype=product.model.choice_type)
    if table.dtype.kind != "f":
        raise PolicyError(f"the policy's table has type {table.dtype}; give integers (choices) or floats (weights)")
    if table.shape not in ((*base, most), (*timed, most)):
        raise PolicyError(f"the policy's weights have shape {table.shape}; give {(*base, most)} or {(*timed, most)}")
    unavailable = np.arange(most) >= n_choices[:, None, None]
    bad = ~np.isfinite(table).all(axis=-1) | (table < 0).any(axis=-1) | (abs(table.sum(axis=-1) - 1) > 1e-9)
    bad |= (table * unavailable != 0).any(axis=-1)
    if bad.any():
        where = tuple(int(i) for i in np.argwhere(bad)[0])
        raise PolicyError(
            f"the policy's weights {table[where].tolist()} are not a distribution over the {n_choices[where[-2]]} "
            f"choices of {product.describe(where[-2] * base[1] + where[-1])}"
        )
    return np.ascontiguousarray(table, dtype=np.float64)


def _arrays(path: Path, product: Product | JointProduct) -> dict[str, NDArray[Any]]:
    """The arrays of a file, each measured before it is unpacked: a few bytes may claim to be any size.

    PolicyError if they are not of a type and shape that a policy of this product has; SizeError if there is no memory.
    """
    (S, Q), h, most = product.shape, product.horizon, product.model.most_choices
    pairs = h * S * -(-Q // 64)
    longest = {"first": h, "last": h, "start": h + 1, "keys": pairs, "bits": pairs, "choice": h * S * Q}
    found = {}
    try:
        with open_arrays(path, "policy file") as archive:
            for name in sorted(set(archive.names) - {"header"}):
                kind, shape = archive.declared(name)
                if name == "table":
                    weights = (most,) if kind.kind == "f" else ()
                    if kind.kind not in "iuf" or shape not in ((S, Q, *weights), (h, S, Q, *weights)):
                        raise ValueError
                elif len(shape) != 1 or shape[0] > longest[name] or kind != (_PARTS[name] or kind) or kind.hasobject:
                    raise ValueError
                require_memory(
                    kind.itemsize * math.prod(shape), f"the policy's {name} of {shape} entries", "learn it again"
                )
                found[name] = archive.read(name, kind, shape)
    except ValueError:
        raise PolicyError(_MISFIT) from None
    return found


def _of_arrays(product: Product | JointProduct, arrays: dict[str, NDArray[Any]]) -> Choices:
    """Choices by step from a file's arrays; PolicyError if they are inconsistent."""
    for name, kind in _PARTS.items():
        found = arrays[name]
        if found.ndim != 1 or not (found.dtype == kind if kind is not None else found.dtype.kind == "u"):
            raise PolicyError(f"the policy's {name} are of type {found.dtype} and shape {found.shape}; save it again")
    first, last, start, keys, bits, choice = (arrays[name] for name in _PARTS)
    if (
        not len(first) == len(last) == len(start) - 1
        or not len(keys) == len(bits) == start[-1]
        or start[0] != 0
        or (start[1:] < start[:-1]).any()
        or len(choice) != int(np.bitwise_count(bits).sum(dtype=np.int64))
    ):
        raise PolicyError(_MISFIT)
    return Choices.of_arrays(product.shape, product.horizon, arrays, product.model.choice_type)


def _required(product: Product | JointProduct, choices: Choices) -> Choices:
    """Choices from a file, checked before use."""
    if not choices.fits(np.diff(product.model.choice_start)):
        raise PolicyError(_MISFIT)
    return choices


_MISFIT = "the policy's choices are inconsistent, or do not fit its task and model; save it again"


def _read_q_table(path: str | Path) -> tuple[list[str], tuple[NDArray[np.float64], NDArray[np.float64]]]:
    lines = csv.reader(read_text(path, "Q-table").splitlines())
    try:
        reader = iter(list(lines))
    except csv.Error as error:
        raise PolicyError(f"{path}, line {lines.line_num}: not a Q-table in CSV: {error}") from None
    header = next(reader, [])
    names = [name.strip() for name in header[1:]]
    keys: list[list[float]] = []
    values: list[list[float]] = []
    for number, row in enumerate(reader, start=2):
        if not row:
            continue
        try:
            if len(row) != len(header):
                raise ValueError
            key = [double(text) for text in row[0].strip().strip("[]()").replace(",", " ").split()]
            value = [double(text) for text in row[1:]]
            if keys and len(key) != len(keys[0]):
                raise ValueError
        except ValueError:
            raise PolicyError(
                f"{path}, line {number}: not a row of a Q-table; write "
                f'"[signals… flags…]",{",".join(names) or "value,value,…"} with finite numbers'
            ) from None
        keys.append(key)
        values.append(value)
    if not keys:
        raise PolicyError(f"{path}: the Q-table has no rows")
    return names, (np.array(keys), np.array(values))


def _find_rows(
    path: str | Path, wanted: NDArray[np.float64], known: NDArray[np.float64], what: str
) -> NDArray[np.int64]:
    """For every wanted row, the index of the known row equal to it."""
    rounded = {_key(row): i for i, row in enumerate(known.tolist())}
    if len(rounded) < len(known):
        raise PolicyError(f"{path}: the model's signals do not distinguish its states, so no Q-table can refer to them")
    found = np.empty(len(wanted), dtype=np.int64)
    for number, row in enumerate(wanted.tolist()):
        index = rounded.get(_key(row))
        if index is None:
            shown = " ".join(f"{value:g}" for value in wanted[number])
            examples = (" ".join(f"{value:g}" for value in line) for line in known[:8])
            raise PolicyError(f"{path}: row {number + 1}: there is no {what} {shown}; {near_misses(shown, examples)}")
        found[number] = index
    return found


def _key(row: list[float]) -> tuple[int, ...]:
    return tuple(round(value / _SIGNAL_TOLERANCE) for value in row)
