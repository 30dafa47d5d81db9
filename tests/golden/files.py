"""Refusals of model, trace, policy, certificate, sweep, checkpoint and report files, and of the arrays of models."""

import re
from pathlib import Path

import numpy as np

import stltool as stl
from stltool.models.parameters import read_affine
from stltool.reporting import load_report
from tests import test_policy, test_written
from tests.checking import test_black_box, test_certificate
from tests.cli import test_gymnasium as gymnasium_files
from tests.conftest import FACTORY
from tests.golden.capture import refusal, rows
from tests.learning import test_checkpoint, test_sweep
from tests.models import (
    test_composition,
    test_explicit,
    test_grid,
    test_gymnasium,
    test_intervals,
    test_mdp,
    test_normalize,
    test_parameters,
)
from tests.models.gymnasium_envs import Listed, Scripted
from tests.monitoring import test_monitor, test_online
from tests.monitoring.logs import test_clock, test_formats
from tests.reporting import test_report


def entries():
    for of_models in (arrays, grids, transition_files, gymnasium_models):
        yield from of_models()
    for of_others in (traces, policies, certificates, sweeps, checkpoints, reports):
        yield from of_others()


def arrays():
    for changes, _ in rows(test_mdp.test_bad_arrays_are_refused_with_state_and_action):
        yield f"MDP.from_arrays, {text_of(changes)}", refusal(test_mdp.build, **changes)
    for row, _ in rows(test_normalize.test_what_is_no_rounding_is_refused):
        yield f"row {row}, normalize", refusal(test_normalize.one_row, *row, normalize=True)
    stay = test_intervals.STAY
    for lower, upper, _ in rows(test_intervals.test_bad_ends_are_refused_with_state_and_action):
        given = f"intervals {text_of(lower)} … {text_of(upper)}"
        yield given, refusal(test_intervals.build, lower=[stay, lower], upper=[stay, upper])
    for changes, _ in rows(test_black_box.test_black_boxes_that_are_none_are_refused):
        options = {"n_states": 2, "actions": 2, "environment": type(None)} | changes
        given = [options.pop(name) for name in ("n_states", "actions", "environment")]
        yield f"MDP.black_box, {text_of(changes)}", refusal(stl.MDP.black_box, *given, **options)


def grids():
    for changes, _ in (*rows(test_grid.test_bad_grids_are_refused), *rows(test_intervals.test_bad_noise_is_refused)):
        yield f"grid, {text_of(changes)}", refusal(test_grid.grid_from_table, test_grid.table(**changes))
    for text in (test_grid.FAULTY, "kind = \n", 'kind = "grid"\nmap = "A"\nmove = "king"'):
        Path("floor.toml").write_text(text, encoding="utf-8")
        yield f"floor.toml:\n{text}".rstrip(), refusal(stl.load_model, "floor.toml")
    for text, _ in rows(test_parameters.test_other_texts_are_refused):
        yield f"probability {text!r}", refusal(read_affine, text, test_parameters.DECLARED)
    for changes, _ in rows(test_parameters.test_faults_of_a_grid_are_reported_with_their_line):
        path = test_parameters.grid(Path(), **changes)
        yield f"floor.toml with {text_of(changes)}", refusal(stl.load_model, path)
    for text, _ in rows(test_composition.test_faults_are_told_with_their_lines):
        path = test_composition.team(Path(), text)
        yield f"{path}:\n{path.read_text(encoding='utf-8')}".rstrip(), refusal(stl.load_model, path)
    for labels, _, _ in rows(test_composition.test_labels_that_are_none):
        model = test_composition.random_model(np.random.default_rng(0), 6)
        yield f"compose, labels = {text_of(labels)}", refusal(stl.compose, [model, model], labels)
    yield "no file", refusal(stl.load_model, "none.toml")
    yield "another ending", refusal(stl.load_model, "floor.yaml")


def transition_files():
    here = Path()
    for files, _ in rows(test_explicit.test_bad_files_are_refused_with_the_line):
        yield f"explicit files, {files}", refusal(stl.load_model, test_explicit.write(here, **files))
    faulty = {
        "tra": "3 4 7\n0 0 1 2:5 go\n0 0 2 3/5 go\n0 0 2 2/5 go\n0 1 0 0.9 wait\n1 0 9 0.25\n1 0 1 7/5\n2 0 2 0.5\n",
        "lab": '0="init" 1="done"\n0: 0\n2: 7\n1_0: 1\n',
        "sta": "(x,up)\n0:(0,true)\n0:(1,true)\n1:(one,true)\n",
    }
    yield f"explicit files, {faulty}", refusal(stl.load_model, test_explicit.write(here, **faulty))
    model = stl.load_model(test_explicit.write(here, lab=None, sta=None))
    for formula in ("F[0,2] done", "F[0,2] x > 0"):
        yield f"{formula} on a model without labels and signals", refusal(stl.build_product, model, stl.parse(formula))
    for share, _ in rows(test_intervals.test_bad_intervals_in_transition_files):
        Path("m.tra").write_text(f"1 1 1\n0 0 0 {share}\n")
        yield f"explicit files, probability {share}", refusal(stl.load_model, "m.tra")
    yield "explicit files, none", refusal(stl.load_model, "none.tra")


def gymnasium_models():
    turns = rows(test_gymnasium.test_a_table_that_is_not_what_the_environment_does_is_refused)
    for number, (turn, _) in enumerate(turns, start=1):
        env = test_gymnasium.Otherwise(test_gymnasium.COIN, turn)
        yield f"an environment with another table {number}", refusal(stl.from_gymnasium, env)
    for row, _ in rows(test_gymnasium.test_tables_that_are_none_are_refused):
        yield f"P[0][0] = {row}", refusal(stl.from_gymnasium, Listed({0: {0: row}, 1: {0: [(1.0, 1, 0, False)]}}))
    for options, _ in rows(test_gymnasium.test_other_spaces_are_refused):
        yield (
            f"spaces {sorted(options)} {type(*options.values()).__name__}",
            refusal(stl.from_gymnasium, Scripted((0, {}), **options)),
        )
    for labels, _ in rows(test_gymnasium.test_labels_that_could_mean_two_things_are_refused):
        given = "a function" if callable(labels) else labels
        yield f"label A = {given}", refusal(stl.from_gymnasium, Scripted((0, {})), {"A": labels})
    for answers, _ in rows(test_gymnasium.test_steps_that_fail):
        env = Scripted((0, {}), answers)
        product = stl.build_product(stl.from_gymnasium(env, {"two": {2}}), stl.parse("F[0,5] two"))
        always = stl.Policy(product, np.ones(product.shape, dtype=int))
        yield f"step() returns {answers}", refusal(stl.sample_run, product, always, seed=0)
    for text, _ in rows(gymnasium_files.test_files_that_say_something_else):
        if "-v" not in text:  # the rest depends on the environments that there are
            Path("lake.toml").write_text(text, encoding="utf-8")
            yield f"lake.toml:\n{text}", refusal(stl.load_model, "lake.toml")


def traces():
    for content, *_ in rows(test_formats.test_what_is_wrong_is_told_with_its_place):
        Path("t.csv").write_bytes(content.encode() if isinstance(content, str) else content)
        yield f"t.csv {content!r}", refusal(stl.load_trace, "t.csv")
    for members, _ in rows(test_formats.test_arrays_that_are_no_signals_are_refused_by_name):
        given = {name: f"{array.dtype} {array.shape}" for name, array in members.items()}
        yield f"t.npz {given}", refusal(stl.load_trace, test_formats.npz(Path("t.npz"), **members))
    for bad, _ in rows(test_formats.test_what_is_not_finite_in_an_npz_is_told_with_its_place):
        yield f"t.npz {text_of(bad)}", refusal(stl.load_trace, test_formats.npz(Path("t.npz"), x=bad))
    for times, _ in rows(test_clock.test_times_at_fault_are_told_with_their_rows):
        Path("t.csv").write_text("\n".join(["t,x", *(f"{time},1" for time in times)]) + "\n")
        yield f"t.csv, step 0.1s, times {times}", refusal(stl.load_trace, "t.csv", ["x"], step="0.1s")
    Path("t.npz").write_bytes(b"PK\x03\x04 broken")
    Path("t.csv").write_text("x,y\n1,2\n")
    yield "t.npz, broken", refusal(stl.load_trace, "t.npz")
    yield "t.csv, another column", refusal(stl.load_trace, "t.csv", ["z"])
    yield "another ending", refusal(stl.load_trace, "t.xls")
    yield "no file", refusal(stl.load_trace, "none.csv")
    for text, signals, *_ in rows(test_monitor.test_traces_that_cannot_be_judged):
        yield f"monitor {text} on {text_of(signals)}", refusal(stl.monitor, stl.parse(text), signals)
    for sample, *_ in rows(test_online.test_a_refused_sample_leaves_the_monitor_as_it_was):
        online = stl.OnlineMonitor(stl.parse("F[0,1] (a & 1 / x > 0.25) & F[1,2] (x > 1e308)"))
        online.feed({"x": 1, "a": 1})

        def feed(online=online, sample=sample):
            online.feed(sample)
            online.feed({"x": 5, "a": 1})

        yield f"feed({text_of(sample)})", refusal(feed)


def patrolling(encoding="exact", **params):
    params = params or {"T": 5, "tau": 5}
    return stl.build_product(
        stl.load_model(FACTORY / "floor-5x5.toml"), stl.load_task(FACTORY / "patrolling.stl", params=params), encoding
    )


def policies():
    flagged = patrolling("paper")
    for table, _ in rows(test_policy.test_tables_that_do_not_fit):
        yield f"policy {table.dtype} {table.shape}", refusal(stl.Policy, flagged, table)
    for text, _ in rows(test_policy.test_bad_q_tables_are_refused):
        Path("q.csv").write_text(text.replace("HEAD", "," + ",".join(flagged.model.action_names)))
        yield f"q.csv {text!r}", refusal(stl.load_policy, "q.csv", flagged)
    stl.check(patrolling()).policy.save("policy.npz")
    yield "policy of other params", refusal(stl.load_policy, "policy.npz", patrolling(T=6, tau=5))
    yield "policy of another encoding", stl.load_policy("policy.npz", flagged).binding.encoding
    model = stl.MDP.from_arrays([np.eye(2)], {"x": [0, 1], "y": [0, 1]}, labels={"A": [0, 1]})
    other = stl.build_product(model, stl.parse("F[0,2] A"))
    yield "policy of another model", refusal(stl.load_policy, "policy.npz", other)
    Path("broken.npz").write_bytes(b"PK\x03\x04 broken")
    yield "broken", refusal(stl.load_policy, "broken.npz", flagged)
    yield "no file", refusal(stl.load_policy, "none.npz", flagged)
    yield "saved as .txt", refusal(stl.check(flagged).policy.save, "p.txt")
    yield from written_policies()
    yield "saved over another file", refusal(stl.check(flagged).policy.save, "broken.npz")
    silent = stl.Policy(flagged, np.full(flagged.shape, -1))
    yield "a policy that says nothing", refusal(stl.check, flagged, silent)


def written_policies():
    product = patrolling()
    stl.check(product).policy.save("written.csv")
    text = Path("written.csv").read_text()
    for old, new, _ in rows(test_written.test_faults_are_told_by_line):
        Path("p.csv").write_text(text.replace(old, new, 1))
        yield f"{old!r} → {new[:60]!r} in written.csv", refusal(stl.load_policy, "p.csv", product)
    for number, (change, _) in enumerate(rows(test_written.test_faults_in_json_are_told_by_line), start=1):
        test_written.changed_json(product, Path("p.json"), change)
        yield f"p.json, changed {number}", refusal(stl.load_policy, "p.json", product)


def certificates():
    product = patrolling()
    path = Path("c.jsonl")
    stl.write_certificate(stl.check(product), path)
    *parts, _ = test_certificate.read(path)
    for number, (change, _) in enumerate(rows(test_certificate.test_what_is_not_of_the_format_is_refused), start=1):
        changed = test_certificate.with_change(parts, change)
        yield f"certificate, changed {number}", refusal(stl.certify, test_certificate.write(path, changed))
    of_policy = Path("p.jsonl")
    stl.write_certificate(stl.check(product, stl.check(product).policy), of_policy)
    *listed, _ = test_certificate.read(of_policy)
    for number, (change, _) in enumerate(rows(test_certificate.test_what_is_not_a_policy_is_refused), start=1):
        changed = test_certificate.with_change(listed, change)
        yield f"certificate of a policy, changed {number}", refusal(stl.certify, test_certificate.write(path, changed))
    for given, changed in (
        ("without its last line", parts[:-1]),
        ("with its last line twice", [*parts, parts[-1]]),
        ("without a layer", test_certificate.with_change(parts, lambda members: members.layers.pop(1))),
        ("without its header", parts[1:]),
        ("that claims 1", [*parts[:-1], {"lower": "1", "upper": "1"}]),
    ):
        yield f"certificate {given}", refusal(stl.certify, test_certificate.write(path, changed))
    yield "certificate without its seal", refusal(stl.certify, test_certificate.write(path, parts, seal=False))
    for content in (b"", b"{}", b"[]\n", b"\x00\xff"):
        path.write_bytes(content)
        yield f"certificate {content!r}", refusal(stl.certify, path)
    yield "no file", refusal(stl.certify, "none.jsonl")


def sweeps():
    for old, new, *_ in rows(test_sweep.test_what_is_wrong_in_a_file_is_named):
        assert old in test_sweep.TINY
        Path("tiny.toml").write_text(test_sweep.TINY.replace(old, new))
        yield f"tiny.toml, {new!r} for {old!r}", refusal(stl.load_sweep, "tiny.toml")
    for text in (
        "[[method]]\nname = 'cfer'\n",
        test_sweep.TINY.split("[[scenario]]")[0],
        "method = []\n[sweep]\n[[scenario]]\nid = 'R'\n",
    ):
        Path("tiny.toml").write_text(text)
        yield f"tiny.toml:\n{text}".rstrip(), refusal(stl.load_sweep, "tiny.toml")


def checkpoints():
    settings = {"episodes": 4, **test_checkpoint.SMALL}
    product = patrolling()
    stl.learn(product, "cfer", checkpoint="run.ckpt", **settings)
    for change, _ in rows(test_checkpoint.test_a_checkpoint_of_another_run_is_refused):
        given = {"method": "cfer", "resume": True, **settings, **change}
        if not isinstance(given["method"], str):
            given = {name: value for name, value in given.items() if name != "optimism"}
        yield f"resumed with {text_of(change)}", refusal(stl.learn, product, checkpoint="run.ckpt", **given)
    other = patrolling(T=6, tau=5)
    yield "resumed with another task", refusal(stl.learn, other, "cfer", checkpoint="run.ckpt", resume=True, **settings)
    header, arrays = test_checkpoint.unpacked(Path("run.ckpt"))
    q, seen, curve = "history time", "counts seen", "history probability"
    changes = {
        "an array is missing": (header, {name: array for name, array in arrays.items() if name != q}),
        "an array is of another shape": (header, {**arrays, q: arrays[q][..., :-1]}),
        "an array is of another type": (header, {**arrays, q: arrays[q].astype(np.float32)}),
        "an array has no numbers": (header, {**arrays, q: np.full_like(arrays[q], np.nan)}),
        "counts are others": (header, {**arrays, seen: arrays[seen] + 1}),
        "the curve has no probabilities": (header, {**arrays, curve: arrays[curve] + 2}),
        "another version": ({**header, "format": "stltool-checkpoint-1"}, arrays),
    }
    for name, value in (("episode", -1), ("steps", 2**80), ("status", "over"), ("generators", []), ("what", 5)):
        changes[f"{name} is {value}"] = ({**header, name: value}, arrays)
    files = {given: test_checkpoint.packed(*changed) for given, changed in changes.items()} | {"a text": b"text"}
    for given, content in files.items():
        Path("run.ckpt").write_bytes(content)
        resumed = refusal(stl.learn, product, "cfer", checkpoint="run.ckpt", resume=True, **settings)
        yield f"checkpoint: {given}", resumed


def reports():
    for (text,) in rows(test_report.test_what_is_no_report):
        Path("report.json").write_text(text)
        yield f"report.json {text!r}", refusal(load_report, Path("report.json"))


def text_of(value):
    """A value of a table's row, short and the same everywhere."""
    if isinstance(value, dict):
        return ", ".join(f"{name} = {text_of(one)}" for name, one in value.items())
    if callable(value) and not isinstance(value, type):
        return "a function"
    return re.sub(r"\s+", " ", str(value))
