"""Policies as text: what is written, and what is read of what people write."""

import csv
import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import stltool as stl
from stltool.errors import FileError, PolicyError, SizeError, StlToolError
from stltool.reached import reachable, reached_by
from tests.checking.test_black_box import hidden
from tests.checking.test_check import products, random_policy
from tests.conftest import FACTORY, ROOT, many


def agree(product, one, other):
    """Whether two policies do the same, bit for bit, wherever runs can come to."""
    for t, codes in enumerate(reachable(product)):
        s, q = np.divmod(codes, product.automaton.n_states)
        if len(s):
            assert np.array_equal(one.form.at(t, s, q), other.form.at(t, s, q))


@given(products(), st.integers(0, 2**32 - 1), st.booleans(), st.booleans(), st.sampled_from(["csv", "json"]))
@settings(max_examples=many(60))
def test_a_policy_survives_its_text_to_the_bit(tmp_path_factory, product, seed, timed, mixed, kind):
    policy = random_policy(product, np.random.default_rng(seed), timed, mixed)
    folder = tmp_path_factory.mktemp("policies")
    policy.save(folder / f"one.{kind}")
    again = stl.load_policy(folder / f"one.{kind}", product)
    agree(product, policy, again)
    assert stl.check(product, again).probability == stl.check(product, policy).probability
    again.save(folder / f"two.{kind}")
    assert (folder / f"one.{kind}").read_bytes() == (folder / f"two.{kind}").read_bytes()
    if any(map(len, reachable(product))):
        assert (again.stationary, again.deterministic) == (policy.stationary, not mixed)


@pytest.fixture
def best(patrolling):
    return stl.check(patrolling).policy


@pytest.fixture
def text(best, tmp_path):
    best.save(tmp_path / "p.csv")
    return (tmp_path / "p.csv").read_text()


def test_rules_are_in_the_order_of_a_run_and_only_of_what_can_happen(patrolling, best, text):
    rows = text.splitlines()
    begin = rows.index("from,to,state,remembered,action")
    assert rows[begin + 1] == '0,0,"(1,0)",at_A not seen for 1 step; at_B not seen for 1 step,NE'
    split = rows.index("# elsewhere,situations that only other choices lead to")
    own, other = rows[begin + 1 : split], rows[split + 1 :]
    nodes, reached = reachable(patrolling), reached_by(patrolling, best.form)
    assert 0 < len(own) <= sum(map(len, reached)) < sum(map(len, nodes))
    assert len(own) + len(other) <= sum(map(len, nodes))
    first = [int(row.partition(",")[0]) for row in own]
    assert first == sorted(first)
    assert sum(row.partition(",")[0] != row.split(",")[1] for row in own + other) > 0  # ranges of steps


def test_the_page_shows_how_a_file_begins(text):
    page = (ROOT / "docs" / "policies.md").read_text()
    shown = page.partition("```csv\n")[2].partition("…\n")[0]
    assert shown.count("\n") == 14
    assert text.startswith(shown)


def test_steps_are_merged_over_steps_at_which_no_run_is_there(tmp_path):
    """A run that goes to and fro is in a state at every other step."""
    model = stl.MDP.from_arrays([[[0, 1], [1, 0]]] * 2, {}, labels={"A": [0, 0]}, action_names=["go", "run"])
    product = stl.build_product(model, stl.parse("F[0,9] A"))
    policy = stl.Policy(product, np.zeros((9, *product.shape), dtype=int))
    policy.save(tmp_path / "p.csv")
    rows = (tmp_path / "p.csv").read_text().splitlines()
    assert [row.split(",")[:3] for row in rows[-2:]] == [["0", "8", "0"], ["1", "7", "1"]]


def test_a_hand_edited_action_counts(patrolling, best, text, tmp_path):
    path = tmp_path / "edited.csv"
    path.write_text(text.replace("at_B not seen for 1 step,NE", "at_B not seen for 1 step,E", 1))
    edited = stl.load_policy(path, patrolling)
    changed = stl.check(patrolling, edited)
    assert changed.probability < stl.check(patrolling, best).probability
    table = best.table.copy()
    s = int(patrolling.model.initial.argmax())
    table[0, s, patrolling.enter(s, patrolling.automaton.initial)] = patrolling.model.action_names.index("E")
    assert changed.probability == stl.check(patrolling, stl.Policy(patrolling, table)).probability


def test_a_policy_is_written_by_hand(patrolling, tmp_path):
    """State and action are enough: it then acts alike at all steps, whatever is remembered."""
    states = [name.replace(",", ", ") for name in patrolling.model.state_names]
    (tmp_path / "p.csv").write_text("state,action\n" + "".join(f'"{state}",NE\n' for state in states))
    policy = stl.load_policy(tmp_path / "p.csv", patrolling)
    always = np.full(patrolling.shape, patrolling.model.action_names.index("NE"))
    agree(patrolling, policy, stl.Policy(patrolling, always))
    assert policy.stationary


def test_what_a_spreadsheet_makes_of_it_is_read(patrolling, best, text, tmp_path):
    """Semicolons, padded facts, carriage returns, a byte order mark."""
    path = tmp_path / "saved.csv"
    rows = list(csv.reader(text.splitlines()))
    lines = [";".join(f'"{cell}"' for cell in row + [""] * (5 - len(row))) for row in rows]
    path.write_bytes(b"\xef\xbb\xbf" + "\r\n".join(lines).encode())
    agree(patrolling, best, stl.load_policy(path, patrolling))


def test_rules_hold_at_their_steps_only(patrolling, tmp_path):
    path = tmp_path / "p.csv"
    path.write_text('from,to,state,action\n1,2,"(1,0)",N\n4,4,"(1,0)",E\n,0,"(1,0)",W\n6,,"(1,0)",S\n')
    policy, names = stl.load_policy(path, patrolling), patrolling.model.action_names
    s = patrolling.model.state_names.index("(1,0)")
    found = [int(policy.at(t, s, 0)[0]) for t in range(patrolling.horizon)]
    assert [names[i] if i >= 0 else "" for i in found] == ["W", "N", "N", "", "E", "", "S", "S"]
    assert [int(policy.row(t)[s, 0]) for t in range(patrolling.horizon)] == found
    assert [policy.form.alike(t) for t in range(4)] == [(0, 0), (1, 2), (1, 2), (3, 3)]
    assert (policy.row(3) == -1).all()


def test_a_missing_rule_is_told_where_it_is_needed(patrolling, text, tmp_path):
    path = tmp_path / "p.csv"
    path.write_text("\n".join(line for line in text.splitlines() if not line.startswith("0,")) + "\n")
    with pytest.raises(PolicyError, match=r"defines no action at step 0, state \(1,0\)"):
        stl.check(patrolling, stl.load_policy(path, patrolling))
    mixed = [line for line in text.splitlines() if not line.startswith("0,")]
    begin = mixed.index("from,to,state,remembered,action")
    mixed = [f"{line},1" if i > begin and not line.startswith("#") else line for i, line in enumerate(mixed)]
    mixed[begin] += ",weight"
    path.write_text("\n".join(mixed) + "\n")
    policy = stl.load_policy(path, patrolling)
    for engine in ("nodes", "words"):
        with pytest.raises(PolicyError, match=r"defines no action at step 0, state \(1,0\)"):
            stl.check(patrolling, policy, engine=engine)
    for sample in (stl.sample_run, lambda *given: stl.estimate(*given, runs=3)):
        with pytest.raises(PolicyError, match=r"defines no action at step 0, state \(1,0\)"):
            sample(patrolling, policy)


FAULTS = [
    ("0,0,\"(1,0)\"", "0,0,\"(1,00)\"", r"p.csv, line 9: there is no state '\(1,00\)'; did you mean \(1,0\)"),
    (",NE\n", ",North\n", "p.csv, line 9: 'North' is not an action of the model"),
    ("at_A not seen for 1 step;", "at_A not seen for one step;", "p.csv, line 9: nothing is remembered as .* did you"),
    ("0,0,", "0,8,", "p.csv, line 9: steps 0 to 8; give steps from 0 to 7"),
    ("0,0,", "1,0,", "p.csv, line 9: steps 1 to 0; give steps"),
    ("0,0,", "zero,0,", "p.csv, line 9: from is 'zero'; give a step"),
    ("0,0,", "0," + "9" * 5000 + ",", "p.csv, line 9: to is '999"),
    ("0,0,\"(1,0)\"", "0,0,(1,0)", "p.csv, line 9: 6 cells for 5 columns; put quotation marks"),
    ("remembered,action", "remembered,act", "p.csv, line 8: there is no column 'act'; did you mean action"),
    ("from,to,state,", "from,to,action,", "line 8: two columns are called action"),
    ("# encoding", "# encodng", "p.csv, line 3: there is no fact 'encodng'; did you mean encoding"),
    ("# encoding,exact", "# encoding,exac", "a damaged policy file: .*exac"),
    ("stltool-policy-text-1", "stltool-policy-text-9", "line 1: a policy of the format stltool-policy-text-9, which"),
    ("# task,", "# task,F[0;4] A\n# task,", "p.csv: (this policy is for the task F|a damaged)"),
    ("# define at_A,A", "# define at_A,A &", "p.csv: the definition at_A: "),
    ("\n1,1,", "\n0,1,\"(1,0)\",,E\n1,1,", r"line 10: this rule and that of .*, line 9 are both for step 0, state"),
    ("# model,floor-5x5\n# model digest,", "# model,floor\n# model digest,0", "is for the model floor .*not for"),
]  # fmt: skip


@pytest.mark.parametrize(("old", "new", "says"), FAULTS)
def test_faults_are_told_by_line(patrolling, text, tmp_path, old, new, says):
    assert old in text
    (tmp_path / "p.csv").write_text(text.replace(old, new, 1))
    with pytest.raises(PolicyError, match=says):
        stl.load_policy(tmp_path / "p.csv", patrolling)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda d: d["rules"][0].update(state="(1,9)"), r"p.json, line 8: there is no state '\(1,9\)'"),
        (lambda d: d["rules"][2].update(action=3), "p.json, line 10: the action is not text"),
        (lambda d: d["rules"][2].update(act="E"), "p.json, line 10: a rule has no 'act'; did you mean action"),
        (lambda d: d["rules"][1].pop("state"), "p.json, line 9: a rule without state"),
        (lambda d: d["rules"][1].update(to=1.5), "p.json, line 9: to is 1.5; write a step"),
        (lambda d: d["rules"][1].update(remembered=5), "line 9: remembered is 5"),
        (lambda d: d["rules"][1].update(action={"E": 0.5, "N": 0.6}), "line 9: the weights sum to 1.1"),
        (lambda d: d["rules"][1].update(action={"E": "a"}), "line 9: the weight of E"),
        (lambda d: d["rules"][1].update(action={"E": -1, "N": 2}), "line 9: the weight of E is -1"),
        (lambda d: d["elsewhere"][0].update(action="up"), "p.json, line 38: 'up' is not an action"),
        (lambda d: d["rules"].insert(1, "N"), "p.json, line 9: not a rule"),
        (lambda d: d.update(rules={}), 'it has no list "rules"'),
        (lambda d: d.update(elsewhere=4), "elsewhere is not a list"),
        (lambda d: d.update(taks="F[0,1] A"), "there is no fact 'taks' with such a value; did you mean task"),
    ],
)
def test_faults_in_json_are_told_by_line(patrolling, tmp_path, change, says):
    changed_json(patrolling, tmp_path / "p.json", change)
    with pytest.raises(PolicyError, match=says):
        stl.load_policy(tmp_path / "p.json", patrolling)


def changed_json(product, path, change):
    """The best policy with a change in its data, a rule a line."""
    path.unlink(missing_ok=True)
    stl.check(product).policy.save(path)
    data = json.loads(path.read_text())
    change(data)
    lines = [f'"{name}": {json.dumps(value)}' for name, value in data.items() if not isinstance(value, list)]
    for name in ("rules", "elsewhere"):
        if isinstance(data[name], list):
            lines.append(f'"{name}": [\n' + ",\n".join(map(json.dumps, data[name])) + "\n]")
    path.write_text("{" + ",\n".join(lines) + "}")


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "not a policy in JSON"),
        ('{"rules": [\n{"state": "a" "action"}]}', "line 2: not a policy in JSON"),
        ('{"rules": [], "rules": []}', "'rules' is given twice"),
        ("[" * 100_000, "not a policy in JSON"),
        ('{"rules": [{"state": ' + "9" * 5000 + ', "action": "E"}]}', "p.json"),
    ],
)
def test_what_is_not_json(patrolling, tmp_path, text, says):
    (tmp_path / "p.json").write_text(text)
    with pytest.raises(PolicyError, match=says):
        stl.load_policy(tmp_path / "p.json", patrolling)


def test_all_faults_are_told_together(patrolling, text, tmp_path):
    (tmp_path / "p.csv").write_text(text.replace(",stay\n", ",halt\n"))
    with pytest.raises(PolicyError) as caught:
        stl.load_policy(tmp_path / "p.csv", patrolling)
    assert str(caught.value).count("'halt' is not an action") == 20
    assert str(caught.value).endswith("errors; the first 20 are shown")


def test_text_of_another_task_names_both(floor5, best, text, tmp_path):
    other = stl.build_product(floor5, stl.parse("F[0,5) A"))
    with pytest.raises(PolicyError, match=r"is for the task G\[0,4\] .*, not for F\[0,4\] A"):
        stl.load_policy(tmp_path / "p.csv", other)


def test_memories_that_words_do_not_tell_apart_have_numbers(patrolling, tmp_path):
    history = stl.build_product(patrolling.model, patrolling.formula, "history")
    policy = stl.check(history).policy
    policy.save(tmp_path / "p.csv")
    assert "# automaton digest," in (tmp_path / "p.csv").read_text()
    agree(history, policy, stl.load_policy(tmp_path / "p.csv", history))


def test_policies_of_another_encoding_joint_tasks_functions_and_black_boxes(patrolling, flagged, tmp_path):
    path = tmp_path / "p.csv"
    learned = stl.learn(flagged, "cfer", episodes=30, seed=0).policy
    learned.save(path)
    elsewhere = stl.load_policy(path, patrolling)  # the flags as memory, judged by the exact automaton
    assert elsewhere.home.automaton.encoding == "paper"
    assert stl.check(patrolling, elsewhere).probability == pytest.approx(stl.check(patrolling, learned).probability)

    joint = stl.build_joint_product(patrolling.model, {"a": stl.parse("F[0,4] A"), "b": stl.parse("F[0,4] (y > 0.6)")})
    both = stl.tradeoff(joint, "a", at_least={"b": 0.2}).policy
    both.save(path)
    for task in joint.tasks:
        again = stl.load_policy(path, task)
        assert stl.check(task, again).probability == pytest.approx(stl.check(task, both).probability, abs=1e-12)

    def rule(here):
        return "N" if "A" in here.labels else here.actions[-1]

    asked = stl.Policy.from_function(patrolling, rule)
    asked.save(path)
    assert "# elsewhere" not in path.read_text()
    assert (
        stl.check(patrolling, stl.load_policy(path, patrolling)).probability == stl.check(patrolling, asked).probability
    )


@pytest.mark.parametrize("kind", ["npz", "csv", "json"])
def test_a_policy_with_two_memories_survives_its_file(patrolling, flagged, tmp_path, kind):
    """A tree of a policy with flags, on the exact product: `explain --policy flags.npz --out tree.npz`."""
    tree = stl.policy_tree(patrolling, stl.check(flagged).policy, price=0.1).policy
    assert tree.home.automaton.n_states > patrolling.automaton.n_states
    tree.save(tmp_path / f"tree.{kind}")
    again = stl.load_policy(tmp_path / f"tree.{kind}", patrolling)
    assert stl.check(patrolling, again).probability == stl.check(patrolling, tree).probability


def test_what_could_not_be_loaded_is_not_saved(patrolling, tmp_path):
    joint = stl.build_joint_product(patrolling.model, {"a": stl.parse("F[0,4] A"), "b": stl.parse("F[0,4] (y > 0.6)")})
    both = stl.tradeoff(joint, "a", at_least={"b": 0.2}).policy
    _, here = both.on(joint.tasks[0])
    with pytest.raises(PolicyError, match="remembers more than its task, .*; save the policy that it was made from"):
        here.save(tmp_path / "p.npz")
    assert not list(tmp_path.iterdir())


def test_a_function_in_a_black_box_is_not_text(floor5, tmp_path):
    product = stl.build_product(hidden(floor5), stl.parse("F[0,3] A"))
    with pytest.raises(PolicyError, match="a policy function that acts in a black box"):
        stl.Policy.from_function(product, lambda here: "N").save(tmp_path / "p.csv")


def test_a_black_box_has_rules_wherever_the_policy_acts(floor5, tmp_path):
    product = stl.build_product(hidden(floor5), stl.parse("F[0,3] A"))
    policy = stl.learn(product, "naive", episodes=50, seed=0).policy
    policy.save(tmp_path / "p.csv")
    again = stl.load_policy(tmp_path / "p.csv", product)
    agree(product, policy, again)


def test_text_replaces_text_of_ours_only(best, tmp_path):
    for name in ("p.csv", "p.json"):
        path = tmp_path / name
        for other in ("a,b\n1,2\n", '{"format": "stltool-report-1"}\n'):  # of another tool, and another file of ours
            path.write_text(other)
            with pytest.raises(FileError, match="does not contain a policy that stltool wrote"):
                best.save(path)
        path.unlink()
        best.save(path)
        best.save(path)


def test_too_many_situations_are_not_text(patrolling, best, monkeypatch, tmp_path):
    monkeypatch.setattr("stltool.written._MOST_RULED", 10)
    with pytest.raises(SizeError, match="too many for text; save it as .npz"):
        best.save(tmp_path / "p.csv")
    monkeypatch.undo()
    monkeypatch.setattr("stltool.written.MOST_NODES", 10)  # only those of the policy
    best.save(tmp_path / "p.csv")
    assert "# elsewhere" not in (tmp_path / "p.csv").read_text()
    assert stl.check(patrolling, stl.load_policy(tmp_path / "p.csv", patrolling)).probability == pytest.approx(
        0.737948, 1e-6
    )


@pytest.mark.parametrize("kind", ["csv", "json", "npz"])
def test_whatever_is_damaged_is_refused_or_read(patrolling, best, tmp_path, kind):
    """The readers' fuzzer in small (bench/fuzz_policies.py): bytes changed, cut out and doubled."""
    path = tmp_path / f"p.{kind}"
    best.save(path)
    whole, rng, refused = path.read_bytes(), np.random.default_rng(0), 0
    for _ in range(many(150)):
        damaged = bytearray(whole)
        a, b = sorted(rng.integers(0, len(whole), 2).tolist())
        match int(rng.integers(4)):
            case 0:
                damaged[a] = int(rng.integers(256))
            case 1:
                del damaged[a : min(b, a + 40)]
            case 2:
                damaged[a:a] = damaged[a : min(b, a + 40)]
            case 3:
                damaged[a : a + 1] = bytes(rng.choice(list(b',"\n{}[]:0#-e\\'), 2).tolist())
        path.write_bytes(bytes(damaged))
        try:
            stl.load_policy(path, patrolling)
        except StlToolError as error:
            refused += f"p.{kind}" in str(error)
    assert refused > many(50)


def test_an_archive_is_measured_before_it_is_unpacked(patrolling, tmp_path, monkeypatch):
    """A few kilobytes that claim to be a large table are refused by what they claim."""
    stl.check(patrolling).policy.save(tmp_path / "p.npz")
    with np.load(tmp_path / "p.npz") as archive:
        header = archive["header"]
    np.savez_compressed(tmp_path / "bomb.npz", header=header, table=np.zeros((8, 18, 36_000), dtype=np.int16))
    with pytest.raises(PolicyError, match="bomb.npz: the policy's choices are inconsistent, or do not fit"):
        stl.load_policy(tmp_path / "bomb.npz", patrolling)
    np.savez_compressed(tmp_path / "long.npz", header=np.full(2**25, 32, dtype=np.uint8), table=np.zeros(3))
    with pytest.raises(PolicyError, match="not a policy file"):
        stl.load_policy(tmp_path / "long.npz", patrolling)


def test_files_of_the_factory(tmp_path):
    """The paper's task: a policy of thousands of situations is a table that loads again."""
    task = stl.load_task(FACTORY / "patrolling.stl", params={"T": 8, "tau": 8})
    product = stl.build_product(stl.load_model(task.model), task)
    policy = stl.check(product).policy
    policy.save(tmp_path / "p.json")
    agree(product, policy, stl.load_policy(tmp_path / "p.json", product))
