"""The engines of the one induction against a dense one in fractions, against each other to the bit, and their laws."""

import itertools
from fractions import Fraction

import numpy as np
import pytest

import stltool as stl
from stltool.automata import FALSE, TRUE
from stltool.checking.fixed import fixed_point
from stltool.checking.induction.allowed import EVERYTHING, Following, Silent
from stltool.checking.induction.arithmetic import Digits, Doubles, Fixed, Integers, row_sums
from stltool.checking.induction.edges import OPEN, REST, SURE
from stltool.checking.induction.graph import Game
from stltool.checking.induction.induct import induct, layers_of
from stltool.checking.induction.nodes import Nodes
from stltool.checking.induction.reached import Reached, Stretch
from stltool.checking.induction.words import Words
from stltool.choices import Table, Through
from tests import dense
from tests.conftest import many

ENGINES = ("nodes", "words")
FORMULAS = (
    "F[0,4] a", "G[0,3] a", "G[0,3] F[0,2] a", "a U[1,4] b", "F[0,3] G[0,2] (a & !b)", "G[0,4] (a -> F[0,2] b)",
    "x > 0.5 U[0,4] a", "F[0,1] a", "(F[0,3] a) & (G[0,2] !b)", "F[0,12] (a & b)", "G[0,5] ((F[0,3] a) & (F[0,3] b))",
)  # fmt: skip


def random_model(rng, n_states, n_actions, denominator):
    """Sparse rows over one denominator, some actions unavailable, several first states at times."""
    matrices = []
    for a in range(n_actions):
        matrix = np.zeros((n_states, n_states), dtype=object)
        for s in range(n_states):
            if a and rng.random() < 0.3:
                continue
            n = int(rng.integers(1, 4))
            for share in rng.multinomial(denominator, np.ones(n) / n):
                if share:
                    matrix[s, rng.integers(n_states)] += Fraction(int(share), denominator)
        matrices.append(matrix)
    first = int(rng.integers(n_states)) if rng.random() < 0.7 else [Fraction(1, n_states)] * n_states
    labels = {"a": rng.random(n_states) < 0.4, "b": rng.random(n_states) < 0.3}
    return stl.MDP.from_arrays(matrices, {"x": rng.random(n_states)}, initial=first, labels=labels)


def random_product(seed, most_states=8, formula=None):
    rng = np.random.default_rng(seed)
    model = random_model(rng, int(rng.integers(1, most_states)), int(rng.integers(1, 4)), int(rng.choice([2, 7, 100])))
    return stl.build_product(model, stl.parse(formula or FORMULAS[seed % len(FORMULAS)])), rng


def random_policy(product, rng, form):
    n_choices = np.diff(product.model.choice_start)
    shape = product.shape if form == "stationary" else (product.horizon, *product.shape)
    if form in ("stationary", "timed"):
        return stl.Policy(product, (rng.random(shape) * n_choices[:, None]).astype(int))
    weights = np.zeros((*product.shape, int(n_choices.max())))
    for s, q in itertools.product(*map(range, product.shape)):
        weights[s, q, : n_choices[s]] = rng.multinomial(
            int(rng.choice([1, 2, 8])), np.ones(n_choices[s]) / n_choices[s]
        )
    return stl.Policy(product, weights / weights.sum(axis=-1, keepdims=True))


def arithmetics(product, maximize):
    """Name, arithmetic, and what stands for 1 in its first layer when it is done."""
    fixed, D = fixed_point(product.model), product.model.rows.denominator
    yield "double", Doubles(maximize), lambda _: 1.0
    yield "fixed", Fixed(fixed.denominator, fixed.one, maximize), lambda made: made.one
    yield "integers", Integers(D, maximize), lambda made: made.one
    yield "digits", Digits(D, maximize), lambda made: made.one


def start_values(product, layers):
    """The dense values at the first pairs, in order."""
    model, automaton = product.model, product.automaton
    return [layers[0][s][product.enter(s, automaton.initial)] for s in np.flatnonzero(model.initial).tolist()]


def held(arithmetic, value):
    return arithmetic.number(value) if isinstance(arithmetic, Digits) else int(value)


@pytest.mark.soak
@pytest.mark.parametrize("seed", range(many(60)))
def test_every_arithmetic_and_engine_gives_the_dense_value(seed):
    product, _ = random_product(seed)
    for maximize in (True, False):
        wanted = start_values(product, dense.layers(product, maximize))
        for engine in ENGINES:
            for name, arithmetic, one in arithmetics(product, maximize):
                found = induct(Game.of(product), arithmetic, maximize, engine=engine, keep=np.uint8)
                if name in ("integers", "digits"):
                    values = [Fraction(held(arithmetic, v), one(arithmetic)) for v in found.entry]
                    assert values == wanted, (engine, name)
                    continue
                slack = 0 if name == "double" else fixed_point(product.model).roundings(product.horizon)
                for value, exact in zip(found.entry.tolist(), wanted, strict=True):
                    if name == "double":
                        assert abs(Fraction(value) - exact) <= Fraction(1, 10**12)
                    else:
                        assert exact <= Fraction(value, arithmetic.one) <= exact + Fraction(slack, arithmetic.one)
                policy = stl.Policy(product, _table(found.choices, product))
                assert start_values(product, dense.layers(product, policy=policy)) == pytest.approx(
                    list(map(float, wanted)), abs=1e-12
                ), (engine, name)


def _table(choices, product):
    rows = [choices.row(t).astype(np.int64) for t in range(product.horizon)]
    return np.array(rows).reshape(product.horizon, *product.shape) if rows else np.zeros(product.shape, dtype=np.int64)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.soak
@pytest.mark.parametrize("seed", range(many(30)))
def test_following_the_best_choices_gives_the_same_bits(seed, engine):
    product, _ = random_product(seed, most_states=20)
    for maximize in (True, False):
        best = induct(Game.of(product), Doubles(maximize), maximize, keep=np.uint8)
        same = np.arange(product.automaton.n_states)
        for form in (best.choices, Table(_table(best.choices, product)), Through(best.choices, same)):
            again = induct(Game.of(product), Doubles(True), True, Following(form), engine=engine)
            assert np.array_equal(again.entry, best.entry)


@pytest.mark.parametrize("engine", ENGINES)
def test_a_policy_that_is_silent_where_it_can_be_is_found_out(engine, patrolling):
    table = np.zeros(patrolling.shape, dtype=np.int64)
    table[:, 5:] = -1
    with pytest.raises(Silent):
        induct(
            Game.of(patrolling),
            Doubles(True),
            True,
            Following(Table(table)),
            engine=engine,
        )
    far = np.zeros(patrolling.shape, dtype=np.int64)
    far[np.flatnonzero(patrolling.model.initial == 0)] = -1  # standing still at the start, it never gets there
    found = induct(Game.of(patrolling), Doubles(True), True, Following(Table(far)), engine=engine)
    assert found.entry.tolist() == [0.0]


@pytest.mark.parametrize("form", ["stationary", "timed", "mixed"])
@pytest.mark.soak
@pytest.mark.parametrize("seed", range(many(25)))
def test_every_arithmetic_and_engine_gives_a_policys_value(seed, form):
    product, rng = random_product(seed)
    policy = random_policy(product, rng, form)
    wanted = start_values(product, dense.layers(product, policy=policy))
    allowed = Following(Table(policy.table))
    for engine, maximize in itertools.product(ENGINES, (True, False)):
        for name, arithmetic, one in arithmetics(product, maximize):
            if form == "mixed" and name in ("digits", "fixed"):
                continue  # for policies that do not mix
            found = induct(Game.of(product), arithmetic, maximize, allowed, engine=engine)
            if name in ("integers", "digits"):
                assert [Fraction(held(arithmetic, v), one(arithmetic)) for v in found.entry] == wanted, (engine, name)
            else:
                values = found.entry / float(one(arithmetic))
                assert values.tolist() == pytest.approx(list(map(float, wanted)), abs=1e-12), (engine, name)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.soak
@pytest.mark.parametrize("seed", range(many(30)))
def test_what_is_open_and_sure_is_exact(seed, engine):
    """Open pairs are the reached ones strictly between 0 and 1, sure ones the 1s (of a minimum: the 0s)."""
    product, rng = random_product(seed, most_states=6)
    policies = [None, random_policy(product, rng, "stationary"), random_policy(product, rng, "mixed")]
    for policy, maximize in itertools.product(policies, (True, False)):
        values = dense.layers(product, maximize, policy)
        allowed = EVERYTHING if policy is None else Following(Table(policy.table))
        layers = layers_of(Game.of(product), TRUE if maximize else FALSE, allowed, engine=engine, keep=np.uint8)
        stretches = list(layers.backwards())
        for t, reached in enumerate(dense.reached(product, policy)):
            layer = next((x.layer for x in stretches if x.first <= t <= x.last), layers.nothing())
            found_open = set(zip(*(a.tolist() for a in layers.pairs(layer)), strict=True))
            found_sure = set(zip(*(a.tolist() for a in layers.sure_pairs(layer)[:2]), strict=True))
            assert found_open == {(s, q) for s, q in reached if 0 < values[t][s][q] < 1}
            assert found_sure == {(s, q) for s, q in reached if values[t][s][q] == int(maximize)}


def wide_product(seed):
    """More automaton states than a word, and than eight words, hold; several words a state are reached at a time."""
    rng = np.random.default_rng(seed)
    formula = ("G[0,70] F[0,90] a", "G[0,4] ((F[0,25] a) & (F[0,25] b))", "F[0,80] G[0,30] a", "F[0,600] (a & b)")[
        seed % 4
    ]
    labels = rng.random((2, 60)) < 0.1
    matrices = np.zeros((3, 60, 60))
    for a, s in itertools.product(range(3), range(60)):
        for x in rng.integers(60, size=3):
            matrices[a, s, x] += rng.integers(1, 9)
        matrices[a, s] /= matrices[a, s].sum()
    model = stl.MDP.from_arrays(matrices, {}, initial=np.ones(60) / 60, labels={"a": labels[0], "b": labels[1]})
    return stl.build_product(model, stl.parse(formula))


@pytest.mark.soak
@pytest.mark.parametrize("seed", range(many(8)))
@pytest.mark.parametrize("maximize", [True, False])
def test_engines_agree_to_the_bit_and_so_do_any_number_of_threads(seed, maximize):
    product = wide_product(seed) if seed % 2 else random_product(seed, most_states=40)[0]
    arithmetic = Doubles(maximize)
    one = induct(Game.of(product), arithmetic, maximize, engine="nodes", keep=np.uint8)
    for threads in (1, 2, 5):
        other = induct(Game.of(product), arithmetic, maximize, engine="words", keep=np.uint8, threads=threads)
        assert np.array_equal(one.entry, other.entry)
        assert one.swept == other.swept
        for (name, mine), theirs in zip(one.choices.arrays().items(), other.choices.arrays().values(), strict=True):
            assert np.array_equal(mine, theirs), name


@pytest.mark.parametrize(("threads", "most", "far"), [(1, 5, True), (3, 5, False), (3, 2**17, False), (3, 2**17, True)])
def test_ranges_of_states_are_put_together_in_order(threads, most, far, monkeypatch):
    """With ranges of a few words, or a few ranges: their rows are made for each or, if they lead far, together."""
    product = wide_product(1)
    arithmetic = Doubles(True)
    whole = induct(Game.of(product), arithmetic, engine="words", keep=np.uint8)
    for name, words in (("_MOST_WORDS", most), ("_WORTH_WORDS", 5)):
        monkeypatch.setattr(f"stltool.checking.induction.words.{name}", words)
    assert Words(Game.of(product), TRUE, EVERYTHING).crew.far
    monkeypatch.setattr("stltool.checking.induction.words.Crew.far", far)
    parts = induct(Game.of(product), arithmetic, engine="words", keep=np.uint8, threads=threads)
    assert np.array_equal(whole.entry, parts.entry)
    assert np.array_equal(whole.choices.arrays()["choice"], parts.choices.arrays()["choice"])


def test_cells_of_a_floor_lead_to_cells_near_them(floor10):
    product = stl.build_product(floor10, stl.parse("F[0,30] A"))
    assert not Words(Game.of(product), TRUE, EVERYTHING).crew.far


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("make", [Doubles, Fixed], ids=["double", "fixed"])
def test_an_induction_that_repeats_stops_with_the_numbers_of_all_steps(engine, make, floor5):
    """The bits of a sweep that never stops early: what follows the repeat is the same again."""
    for formula in ("F[0,300] C", "!A U[0,300] C", "G[0,200] F[0,12] A"):
        product = stl.build_product(floor5, stl.parse(formula))
        fixed = fixed_point(floor5)
        units = () if make is Doubles else (fixed.denominator, fixed.one)
        quick, slow = make(*units, True), make(*units, True)
        slow.repeats, slow.tiles = False, lambda engine: None
        found = induct(Game.of(product), quick, engine=engine, keep=np.uint8)
        whole = induct(Game.of(product), slow, engine=engine, keep=np.uint8)
        assert found.swept < whole.swept / 2
        assert np.array_equal(found.entry, whole.entry)
        assert np.array_equal(_table(found.choices, product), _table(whole.choices, product))


def test_a_million_steps_cost_as_many_layers_as_it_takes_to_arrive(floor5):
    product = stl.build_product(floor5, stl.parse("F[0,1000000] C"))
    found = induct(Game.of(product), Doubles(True), keep=np.uint8)
    assert found.swept < 100
    assert found.choices.at(500_000, np.array([0]), np.array([product.enter(0, product.automaton.initial)]))[0] >= 0


def test_slots_say_what_is_decided_at_once():
    model = stl.MDP.from_arrays([[[1, 0], [0, 1]]], {}, initial=[0.5, 0.5], labels={"a": [1, 0]})
    product = stl.build_product(model, stl.parse("a & F[0,2] a"))
    for engine, (goal, wanted) in itertools.product(ENGINES, ((TRUE, [SURE, REST]), (FALSE, [REST, SURE]))):
        layers = layers_of(Game.of(product), goal, engine=engine)
        first = next(iter([*layers.backwards()][::-1]), Stretch(0, 0, layers.nothing())).layer
        assert layers.first_slots(first).tolist() == wanted


@pytest.mark.parametrize("kind", [Nodes, Words])
def test_edges_lead_where_the_model_and_the_automaton_do(kind):
    product, rng = random_product(10, most_states=8)
    policy = random_policy(product, rng, "mixed")
    for allowed, live in itertools.product((EVERYTHING, Following(Table(policy.table))), (True, False)):
        layers = kind(Game.of(product), TRUE, allowed, live, live)
        stretches = [*layers.backwards()][::-1]
        for (_, t, here), ahead in zip(stretches, [x.layer for x in stretches[1:]] + [layers.nothing()], strict=True):
            edges = [layers.edges(here, ahead, t, lo, hi) for lo, hi in layers.parts(here)]
            s, q = layers.pairs(here)
            there = dict(zip(zip(*(a.tolist() for a in layers.pairs(ahead)), strict=True), itertools.count(OPEN)))
            sure = set(zip(*(a.tolist() for a in layers.sure_pairs(ahead)[:2]), strict=True))
            verdicts = product.automaton.verdicts(t + 1)
            i = 0
            for part in edges:
                for a, b in itertools.pairwise(part.choices.tolist()):
                    for j in range(a, b):
                        c = int(part.choice[j])
                        k = slice(*part.start[j : j + 2].tolist())
                        rows = range(*product.model.row_start[c : c + 2].tolist())
                        assert part.entry[k].tolist() == list(rows)
                        assert product.model.choice_start[s[i]] <= c < product.model.choice_start[s[i] + 1]
                        for entry, slot in zip(rows, part.child[k].tolist(), strict=True):
                            x = int(product.model.target[entry])
                            after = product.enter(x, int(q[i]))
                            if verdicts[after] >= 0:
                                assert slot == (SURE if verdicts[after] == TRUE else REST)
                            else:
                                assert slot == (SURE if (x, after) in sure else there.get((x, after), REST))
                    i += 1
            assert i == len(s)


@pytest.mark.parametrize("kind", [Nodes, Words])
@pytest.mark.parametrize("seed", range(6))
def test_any_pair_can_be_asked_for_its_edges_and_its_slot(kind, seed):
    """Those of open pairs are the layer's, one by one; what is not listed has the slot of its verdict."""
    product, rng = random_product(seed, most_states=8)
    policy = random_policy(product, rng, "mixed" if seed % 2 else "timed")
    for allowed, live in itertools.product((EVERYTHING, Following(Table(policy.table))), (True, False)):
        layers = kind(Game.of(product), TRUE, allowed, live, live)
        stretches = [*layers.backwards()][::-1]
        following = [*(x.layer for x in stretches[1:]), layers.nothing()][: len(stretches)]
        for (_, t, here), ahead in zip(stretches, following, strict=True):
            s, q = layers.pairs(here)
            assert layers.slots(here, t, s, q).tolist() == list(range(OPEN, OPEN + len(s)))
            if live:
                sure = layers.sure_pairs(here)[:2]
                assert layers.slots(here, t, *sure).tolist() == [SURE] * len(sure[0])
            every = np.divmod(np.arange(product.n_states), product.automaton.n_states)
            known = set(zip(*(a.tolist() for a in (s, q)), strict=True))
            known |= set(zip(*(a.tolist() for a in layers.sure_pairs(here)[:2]), strict=True))
            verdicts = product.automaton.verdicts(t)
            for x, memory, slot in zip(*every, layers.slots(here, t, *every).tolist(), strict=True):
                if (x, memory) not in known:
                    assert slot == (SURE if verdicts[memory] == TRUE else REST)
            fan, whole = layers.fan(t, s, q), [layers.edges(here, ahead, t, lo, hi) for lo, hi in layers.parts(here)]
            found = fan.edges(layers.slots(ahead, t + 1, fan.s_ahead, fan.q_ahead))
            for name in ("s", "q", "choice", "weight", "entry", "child"):
                parts = [getattr(part, name) for part in whole]
                if parts and parts[0] is not None:
                    assert np.array_equal(getattr(found, name), np.concatenate(parts)), name


def test_sums_of_rows_are_added_one_after_another():
    rng = np.random.default_rng(0)
    for _ in range(50):
        length = rng.choice([1, 2, 3, 5, 63, 64, 65, 66, 200], size=rng.integers(1, 30))
        start = np.concatenate([[0], np.cumsum(length)])
        terms = rng.random(start[-1])
        one_by_one = [np.cumsum(terms[a:b])[-1] for a, b in itertools.pairwise(start)]
        assert np.array_equal(row_sums(terms, start), one_by_one)


@pytest.mark.parametrize("most", [0, 1, 7, 10, 35, 100, 10**6])
@pytest.mark.parametrize("n", [0, 1, 2, 3, 8, 31])
def test_layers_that_were_not_kept_are_made_again(n, most):
    """Layers are their own numbers here, of five bytes each; stretches of one to three steps. What comes after a
    layer is asked for at its last step."""
    wanted: list[Stretch] = []

    def after(layer, t):
        assert t == wanted[layer].last
        return layer + 1

    found, first = Reached(after, most), 0
    for i in range(n):
        last = first + i % 3
        found.add(first, last, i, 5)
        wanted.append(Stretch(first, last, i))
        assert found.bytes <= max(most, 5)
        first = last + 1
    assert list(found) == wanted
    assert list(found.back()) == wanted[::-1]
    for before in range(1, first + 1):
        part = [x for x in wanted if x.first < before]
        part[-1] = part[-1]._replace(last=min(part[-1].last, before - 1))
        assert list(found.back(before)) == part[::-1]


def test_layers_are_taken_in_parts_of_few_edges(monkeypatch):
    layers = layers_of(Game.of(wide_product(1)), TRUE, engine="words")
    stretches, most = [Stretch(0, 0, layers.nothing()), *layers.backwards()], 1
    monkeypatch.setattr("stltool.checking.induction.words._PART", 500)
    for ahead, here in itertools.pairwise(stretches):
        parts = layers.parts(here.layer)
        n = [len(layers.edges(here.layer, ahead.layer, here.last, *part).child) for part in parts]
        assert [0, *(last for _, last in parts)] == [*(first for first, _ in parts), len(here.layer.states)]
        assert max(n, default=0) < 500 + 64 * 9 * 3  # what a state has, more or less
        most = max(most, len(parts))
    assert most > 4


@pytest.mark.parametrize("engine", ENGINES)
def test_little_room_for_layers_changes_nothing(engine, monkeypatch):
    product = wide_product(1)
    wanted = induct(Game.of(product), Doubles(True), engine=engine, keep=np.uint8)
    monkeypatch.setattr("stltool.checking.induction.layers._SHARE", 0)
    found = induct(Game.of(product), Doubles(True), engine=engine, keep=np.uint8)
    assert np.array_equal(found.entry, wanted.entry)
    assert np.array_equal(found.choices.arrays()["choice"], wanted.choices.arrays()["choice"])


@pytest.mark.parametrize("engine", ENGINES)
def test_edges_made_in_parts_give_the_same(engine, monkeypatch):
    product = random_product(10, most_states=40)[0]
    D = product.model.rows.denominator
    wanted = induct(Game.of(product), Digits(D, True), engine=engine, keep=np.uint8)
    monkeypatch.setattr(f"stltool.checking.induction.{engine}._PART", 5)
    monkeypatch.setattr("stltool.checking.induction.nodes._KEPT", 0)
    layers = layers_of(Game.of(product), TRUE, engine=engine)
    assert max(len(layers.parts(x.layer)) for x in layers.backwards()) > 3
    found = induct(Game.of(product), Digits(D, True), engine=engine, keep=np.uint8)
    assert np.array_equal(found.entry, wanted.entry)
    assert np.array_equal(found.choices.arrays()["choice"], wanted.choices.arrays()["choice"])
