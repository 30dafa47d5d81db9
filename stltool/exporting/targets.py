"""The formats that `export` writes, one row a format."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from stltool.arguments import flag, require
from stltool.arguments import path as path_of
from stltool.automata import TaskAutomaton
from stltool.automata.graph import to_dot
from stltool.errors import FileError, SettingsError, named, near_misses
from stltool.exporting.explicit import ProductMDP, product_mdp
from stltool.exporting.prism import to_prism
from stltool.exporting.standalone import to_python
from stltool.files import require_result, write_result
from stltool.models.formats.drn_text import drn_text
from stltool.models.save import require_writable, save_model
from stltool.policy import Policy, require_door
from stltool.product import Product


@dataclass(frozen=True, eq=False)
class Request:
    """What is to be exported: an automaton alone, or a product, under a policy if one is given."""

    automaton: TaskAutomaton
    product: Product | None = None
    policy: Policy | None = None
    clock: bool = False

    @cached_property
    def built(self) -> ProductMDP:
        assert self.product is not None  # required by the target
        return product_mdp(self.product, self.policy, clock=self.clock)


@dataclass(frozen=True)
class Target:
    """A format.

    suffixes  of its files, the first one shown first
    what      such a file, in messages
    content   what is in it, for help
    text      the text of a request; None: the format has none
    save      writes a request to a file; None: the text is written
    of        what it is made from: "automaton", "product" or "policy" (a product and a policy)
    """

    suffixes: tuple[str, ...]
    what: str
    content: str
    text: Callable[[Request], str] | None = None
    save: Callable[[Request, Path], None] | None = None
    of: str = "product"


def _python(asked: Request) -> str:
    assert asked.product is not None  # required by the target
    assert asked.policy is not None
    return to_python(asked.product, asked.policy)


TARGETS: dict[str, Target] = {
    "dot": Target(
        (".dot", ".gv"), "graph", "the task's automaton for Graphviz", lambda asked: to_dot(asked.automaton),
        of="automaton",
    ),
    "prism": Target(
        (".prism", ".nm", ".pm"), "PRISM program", "the product as a program for PRISM and Storm",
        lambda asked: to_prism(asked.built),
    ),
    "drn": Target(
        (".drn", ".drn.gz"), "DRN file", "the product, state by state, for Storm",
        lambda asked: drn_text(asked.built.model), lambda asked, path: save_model(asked.built.model, path),
    ),
    "umb": Target(
        (".umb",), "UMB file", "the same in binary, for Storm, PRISM and Modest",
        save=lambda asked, path: save_model(asked.built.model, path),
    ),
    "python": Target(
        (".py",), "Python program", "a policy as a program of its own, for robots", _python, of="policy",
    ),
}  # fmt: skip


def export(
    product: Product | TaskAutomaton,
    path: str | Path,
    to: str | None = None,
    *,
    policy: Policy | None = None,
    clock: bool = False,
) -> None:
    """Write a product in another tool's format: for PRISM and Storm, so that they can check it again, or for Graphviz.

    product  or an automaton alone, where the format shows nothing else
    path     the file; its ending says the format unless `to` does: "dot" (the automaton), "prism" (the product as a
             program of the PRISM language), "drn" and "umb" (the product state by state, as `save_model` writes it),
             "python" (a policy as a program of its own)
    policy   export the Markov chain under this policy
    clock    count steps up to the horizon, so that the property that asks for P has no bound (see `product_mdp`)

    Only what runs reach is written. Labels "satisfied" and "violated" are the verdicts. The properties whose values are
    the probabilities of the task are `product_mdp(product).questions`; a program has them in a comment. Raises
    SettingsError for another format or ending, and what `product_mdp` raises.
    """
    require(product, (Product, TaskAutomaton), "export's product")
    path = path_of(path, "export's path")
    clock = flag(clock, "export's clock")
    require(to, str, "export's to", f"give one of {', '.join(TARGETS)}", optional=True)
    target = target_of(to, path)
    given = product if isinstance(product, Product) else None
    require(policy, Policy, "export's policy", optional=True)
    automaton = product if isinstance(product, TaskAutomaton) else product.automaton
    write(target, Request(automaton, given, policy, clock), path)


def target_of(to: str | None, path: Path | None) -> str:
    """The name of the target: as given, or by the ending of the file; an error for others, and where they differ."""
    if to is None:
        by_ending = [name for name, target in TARGETS.items() if path is not None and _fits(target, path)]
        if not by_ending:
            endings = ", ".join(target.suffixes[0] for target in TARGETS.values())
            missing = f"{path}: no format has this ending" if path is not None else "no format is given"
            example = named("to", "to='prism'")
            raise SettingsError(f"{missing}; write {example}, or name a file that ends in one of {endings}")
        return by_ending[0]
    if to not in TARGETS:
        given = named("to", f"to='{to}'")
        raise SettingsError(f"{given}: there is no such format; {near_misses(to, TARGETS)}")
    if path is not None and not _fits(TARGETS[to], path):
        endings = " or ".join(TARGETS[to].suffixes)
        raise FileError(f"{path}: a {TARGETS[to].what} ends in {endings}; use one of these endings")
    return to


def _fits(target: Target, path: Path) -> bool:
    return path.name.lower().endswith(target.suffixes)


def require_request(name: str, asked: Request) -> None:
    """SettingsError if a target needs more, or less, than was given."""
    target = TARGETS[name]
    if target.of == "automaton":
        if asked.policy is not None:
            raise SettingsError(f"a policy does not change the automaton, which is all that {name} shows; leave it out")
        if asked.clock:
            raise SettingsError(f"{named('clock')} is for the product; leave it out with {name}")
        return
    if asked.product is None:
        raise SettingsError(
            f"{name} is for the product of a task and a model; give one: stl.build_product(model, task)"
        )
    if target.of == "policy":
        if asked.policy is None:
            raise SettingsError(f"{name} needs a policy; give {named('policy', 'policy=…')}")
        if asked.clock:
            raise SettingsError(f"{named('clock')} is for the product; leave it out with {name}")
    require_door("export", asked.product, asked.policy)


def require_file(name: str, path: Path) -> None:
    """FileError, before the work, if a target's file could not be written after it."""
    if TARGETS[name].save is not None:
        require_writable(path)
    else:
        require_result(path, TARGETS[name].what)


def text_of(name: str, asked: Request) -> str:
    """The text of a request. SettingsError if the format has none."""
    require_request(name, asked)
    text = TARGETS[name].text
    if text is None:
        raise SettingsError(f"{name} files are not text; name one to write: {named('out', 'out=…')}")
    return text(asked)


def write(name: str, asked: Request, path: Path) -> None:
    """Write a request to a file, whole or not at all."""
    target = TARGETS[name]
    require_request(name, asked)
    require_file(name, path)
    if target.save is not None:
        target.save(asked, path)
    elif target.text is not None:
        write_result(path, target.text(asked), target.what)
