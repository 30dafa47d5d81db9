"""DRN files whose probabilities depend on parameters → a family of models (models/family.py).

The file does not declare which values a parameter may have. Here it may have all those for which every number is a
probability: with 0 ≤ a + b·p ≤ 1 in every entry,

    p ∈ ∩ [min(−a/b, (1−a)/b), max(−a/b, (1−a)/b)]
"""

from __future__ import annotations

from fractions import Fraction
from typing import TYPE_CHECKING

from stltool.errors import ModelError, SettingsError
from stltool.models.formats.given import model_of
from stltool.models.fractions import Shares, over_one
from stltool.models.loading import Loading
from stltool.models.mdp import MDP
from stltool.models.parameters import Affine, Parameter, Values, read_affine
from stltool.numbers import number_text

if TYPE_CHECKING:
    from stltool.models.formats.drn import Header, Lines, Reader

_FEW = 200_000  # entries; families are made entry by entry


def family_of(reader: Reader, header: Header, name: str, loading: Loading) -> MDP:
    """The family. Raises ModelError for a row that is not linear in one parameter, or does not sum to 1."""
    if loading.normalize:
        raise SettingsError("rows that depend on parameters cannot be rescaled; leave out normalize")
    declared = {one: Parameter(one, Fraction(0), Fraction(1)) for one in header.parameters}

    def no_reward(begin: int, end: int) -> Fraction:
        reader.refuse(begin, "rewards that depend on parameters cannot be read; give the parameters values in Storm")

    lines = reader.lines(header, no_reward)
    if lines.n_entries > _FEW:
        raise ModelError(
            f"{reader.path}: families of more than {_FEW} transitions cannot be read; give values in Storm"
        )
    reader.require_rows(header, lines)
    if len(lines.ends) > 1:
        raise ModelError(f"{reader.path}: probabilities are intervals or depend on parameters, but not both")
    functions = _functions(reader, header, lines, declared)
    domains = _domains(reader, lines, functions)

    def build(**values: Fraction) -> MDP:
        at: Values = {**{one: Fraction(0) for one in declared}, **values}
        probability = Shares(*over_one(function.at(at) for function in functions))
        return model_of(reader.described(header, lines, probability), name, loading, reader.place)

    if not domains:
        return build()
    return MDP.from_family(build, domains)


def _functions(reader: Reader, header: Header, lines: Lines, declared: dict[str, Parameter]) -> list[Affine]:
    """The function of each entry."""
    ends, found = lines.ends[0], []
    known: dict[str, Affine] = {}
    for k in range(lines.n_entries):
        if ends.kind[k] != 2:
            found.append(Affine(ends.at(k)))
            continue
        begin = int(ends.above[k])
        text = reader.text(begin, int(ends.below[k])).strip()
        if text not in known:
            try:
                known[text] = read_affine(header.placeholders.get(text, text), declared)
            except ModelError as error:
                reader.refuse(begin, str(error), quoted=False)
        found.append(known[text])
    for c in range(lines.n_choices):
        row = found[lines.row_start[c] : lines.row_start[c + 1]]
        names = sorted({name for function in row for name in function.slopes})
        if len(names) > 1:
            raise ModelError(
                f"{reader.path}, {reader.place(c)}: the row depends on {' and '.join(names)}; a row may depend on one "
                "parameter"
            )
        total = Affine(Fraction(0))
        for function in row:
            total = total.plus(function)
        if total.slopes or total.constant != 1:
            terms = [f"{number_text(slope)}·{name}" for name, slope in total.slopes.items()]
            shown = " + ".join([number_text(total.constant), *terms])
            raise ModelError(f"{reader.path}, {reader.place(c)}: the probabilities sum to {shown}, not 1")
    return found


def _domains(reader: Reader, lines: Lines, functions: list[Affine]) -> dict[str, tuple[Fraction, Fraction]]:
    """Where each parameter lies that occurs."""
    found: dict[str, tuple[Fraction, Fraction]] = {}
    for k, function in enumerate(functions):
        for name, slope in function.slopes.items():
            ends = sorted((-function.constant / slope, (1 - function.constant) / slope))
            lower, upper = found.get(name, (ends[0], ends[1]))
            found[name] = max(lower, ends[0]), min(upper, ends[1])
            if found[name][0] > found[name][1]:
                reader.refuse(
                    int(lines.entry_at[k]), f"there is no {name} for which this and all others are probabilities"
                )
        if not function.slopes and not 0 <= function.constant <= 1:
            reader.refuse(int(lines.entry_at[k]), "this is not a probability")
    return found
