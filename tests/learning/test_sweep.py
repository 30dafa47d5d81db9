"""Sweeps: what is read, what is run, what is kept."""

import dataclasses
import itertools
import json

import pytest
from filelock import FileLock

import stltool as stl
from stltool.errors import FileError, NameLookupError, SettingsError, StlToolError
from stltool.learning import Budget
from stltool.learning import sweep as stored
from stltool.learning.sweep import Method, estimated_seconds, finished_runs
from tests.conftest import FACTORY, ROOT
from tests.learning.test_learning import Alternating

TINY = f"""
[sweep]
seeds = 2
settings = {{ episodes = 10, evaluate_every = 5 }}
[[method]]
name = "naive"
faithful = true
[[method]]
id = "replay"
name = "naive-er"
settings = {{ batch = 8 }}
[[scenario]]
id = "R"
task = "{FACTORY}/reaching.stl"
params = {{ T = 4, tau = 3 }}
published = {{ naive = 0.5 }}
[[scenario]]
id = "C"
task = "{FACTORY}/charging.stl"
params = {{ T = 4, tau = 3 }}
settings = {{ episodes = 12 }}
"""


@pytest.fixture
def write(tmp_path):
    def write(text=TINY, **replaced):
        for old, new in replaced.items():
            assert old in text
            text = text.replace(old, new)
        path = tmp_path / "tiny.toml"
        path.write_text(text)
        return path

    return write


def files(folder):
    """The bytes of all results in a folder, times apart."""
    found = {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.glob("runs/*/*/seed-*.json")}
    return {name: content for name, content in found.items() if not name.endswith(".time.json")}


def test_a_sweep_is_the_product_of_what_its_file_lists(write):
    sweep = stl.load_sweep(write())
    assert (sweep.name, sweep.seeds, sweep.columns) == ("tiny", (0, 1), 2)
    runs = sweep.runs()
    assert [(r.scenario, r.method, r.seed) for r in runs] == [
        (s, m, n) for s in "RC" for m in ("naive", "replay") for n in (0, 1)
    ]
    by_name = {run.name: run for run in runs}
    text = TINY.replace("episodes = 12", "batch = 9, memory = 7").replace("evaluate_every = 5", "memory = 6, batch = 5")
    over = {run.name: (run.learner, run.budget) for run in stl.load_sweep(write(text)).runs()}
    budget = Budget(episodes=10)
    assert over["C replay seed 0"] == (stl.NaiveER(memory=7, batch=8), budget)
    assert over["R replay seed 0"] == (stl.NaiveER(memory=6, batch=8), budget)
    assert over["C naive seed 0"] == (stl.PublishedNaive(), budget)  # of the others' settings it has none
    assert by_name["C replay seed 1"].budget == Budget(episodes=12, evaluate_every=5)
    assert (by_name["R naive seed 0"].learner.published, by_name["R replay seed 0"].learner.published) == (True, False)
    assert by_name["R naive seed 0"].formula == "F[0,3] F[0,2] A"
    assert sweep.scenarios[0].published == {"naive": 0.5}


def test_the_papers_table_has_all_that_the_paper_has():
    text = (ROOT / "examples" / "paper" / "table.toml").read_text()
    sweep = stl.load_sweep(ROOT / "examples" / "paper" / "table.toml")
    assert [s.id for s in sweep.scenarios] == [f"{kind}{i}" for kind in "RCP" for i in (1, 2, 3, 4)]
    assert [m.id for m in sweep.methods] == ["naive", "naive-er", "cfer", "cfper"]
    assert all(m.faithful for m in sweep.methods)
    assert (len(sweep.runs()), sweep.columns, text.count("published =")) == (480, 4, 5)
    assert sweep.story
    cfper = sweep.methods[3]
    settings = {s.id: sweep.settled(s, cfper) for s in sweep.scenarios}
    table = {name: (s.decay, s.memory, s.period, s.batch, b.episodes) for name, (s, b) in settings.items()}
    small, long, large = (400, 1000, 4, 64, 4000), (400, 1000, 4, 64, 10000), (1000, 10000, 4, 256, 10000)
    assert table == {
        **dict.fromkeys(("R1", "R2", "R3", "R4", "C1", "C2", "P1"), small),
        **dict.fromkeys(("C3", "C4"), long),
        **dict.fromkeys(("P2", "P3", "P4"), large),
    }
    assert all(40 <= b.episodes / b.evaluate_every <= 50 for _, b in settings.values())
    assert {(s.alpha, s.gamma, s.epsilon_start, s.epsilon_end, s.scale) for s, _ in settings.values()} == {
        (0.01, 0.999, 0.99, 0.01, "published")
    }
    windows = {s.id: [int(s.task.params[p]) for p in ("T", "tau")] for s in sweep.scenarios}
    assert windows["R1"] == windows["C3"] == [10, 5]
    assert windows["R2"] == windows["C4"] == windows["P1"] == windows["P3"] == [10, 10]
    assert windows["P2"] == windows["P4"] == [15, 15]
    assert [s.model.n_states for s in sweep.scenarios] == [18, 18, 72, 72] * 3


def test_runs_are_kept_with_what_learning_gives(write, tmp_path):
    sweep = stl.load_sweep(write())
    seen = []
    result = stl.run_sweep(sweep, tmp_path / "out", workers=1, progress=seen.append)
    assert (len(result.runs), result.failures, result.skipped) == (8, [], 0)
    assert [state.done for state in seen] == list(range(1, 9))
    assert seen[-1].share == pytest.approx(1)
    assert all(0 < a.share < b.share for a, b in itertools.pairwise(seen))
    assert seen[-1].steps == sum(run.steps[-1] for run in result.runs)
    for run in result.runs:
        scenario = next(s for s in sweep.scenarios if s.id == run.scenario)
        method = next(m for m in sweep.methods if m.id == run.method)
        learner, budget = sweep.settled(scenario, method)
        training = stl.learn(scenario.product, learner, seed=run.seed, **dataclasses.asdict(budget))
        assert [(p.episode, p.steps, p.probability) for p in training.history] == list(
            zip(run.episode, run.steps, run.probability, strict=True)
        )
        assert run.seconds > 0
    assert len({run.policy for run in result.runs if run.method == "replay"}) > 1
    place = tmp_path / "out" / "runs" / "C" / "replay"
    assert {path.name for path in place.iterdir()} == {f"seed-{n}{e}" for n in (0, 1) for e in (".json", ".time.json")}
    assert b"seconds" not in (place / "seed-0.json").read_bytes()


def test_only_what_is_missing_or_changed_is_run_again(write, tmp_path):
    out, sweep = tmp_path / "out", stl.load_sweep(write())
    first = stl.run_sweep(sweep, out, workers=1)
    whole = files(out)
    again = stl.run_sweep(sweep, out, workers=1, progress=pytest.fail)
    assert [dataclasses.asdict(run) for run in again.runs] == [dataclasses.asdict(run) for run in first.runs]
    assert again.skipped == 8

    # killed between the two files of a run that replaces one with another key: the times are new, the result is old
    changed = stl.load_sweep(write(**{"episodes = 12": "episodes = 11"}))
    stl.run_sweep(changed, out, workers=1)
    for name in whole:
        (out / name).write_bytes(whole[name])
    assert stl.run_sweep(changed, out, workers=1).skipped == 4
    assert stl.run_sweep(sweep, out, workers=1).skipped == 4
    assert files(out) == whole

    spoilt = ["runs/R/naive/seed-0.json", "runs/R/naive/seed-1.time.json", "runs/C/naive/seed-0.json"]
    (out / spoilt[0]).write_bytes(whole[spoilt[0]][:50])
    (out / spoilt[1]).unlink()
    (out / spoilt[2]).write_text("[]")
    with pytest.raises(FileError, match="does not contain a run of a sweep that stltool wrote, and would be lost"):
        stl.run_sweep(sweep, out, workers=1)
    (out / spoilt[2]).write_bytes(whole[spoilt[2]] + b"]")
    seen = []
    mended = stl.run_sweep(sweep, out, workers=1, progress=seen.append)
    assert (len(seen), mended.skipped) == (3, 5)
    assert files(out) == whole

    changed = stl.load_sweep(write(**{"episodes = 12": "episodes = 13"}))
    assert stl.run_sweep(changed, out, workers=1).skipped == 4  # R's
    assert files(out).keys() == whole.keys()
    assert {name for name in whole if files(out)[name] != whole[name]} == {name for name in whole if "/C/" in name}


def test_a_runs_key_is_of_all_that_its_result_depends_on(write):
    def keys(**replaced):
        return [run.key for run in stl.load_sweep(write(**replaced)).runs()]

    base = keys()
    assert len(set(base)) == 8
    assert keys(**{"published = { naive = 0.5 }": "", "evaluate_every = 5": "evaluate_every = 5, alpha = 0.01"}) == base
    for old, new in [
        ("seeds = 2", "seeds = [5, 6]"), ("evaluate_every = 5", "evaluate_every = 6"), ("T = 4", "T = 5"),
        ("faithful = true", "faithful = false"), ('name = "naive"\n', 'name = "cfer"\nid = "naive"\n'),
        (".stl\"", f'.stl"\nmodel = "{FACTORY}/floor-10x10.toml"'),
    ]:  # fmt: skip
        assert any(a != b for a, b in zip(keys(**{old: new}), base, strict=True)), old
        if "naive" not in old and "faithful" not in old:
            assert not set(keys(**{old: new})) & set(base), old
    run = stl.load_sweep(write()).runs()[0]
    assert dataclasses.replace(run, version="0.0.1").key != run.key


def test_learners_of_users_are_swept_too(write, tmp_path):
    """Of the sweep's settings they take those that they have; each run's result is what `learn` gives."""
    sweep = stl.load_sweep(write(**{"evaluate_every = 5": "evaluate_every = 5, memory = 50"})).select(["R"])
    own = Method("own", Alternating, {"turns": 3})
    sweep = dataclasses.replace(sweep, methods=(own, *sweep.methods))
    result = stl.run_sweep(sweep, tmp_path / "out", workers=1)
    assert (len(result.runs), result.failures) == (6, [])
    learner, budget = sweep.settled(sweep.scenarios[0], own)
    assert (learner, budget) == (Alternating(turns=3), Budget(episodes=10, evaluate_every=5))
    training = stl.learn(sweep.scenarios[0].product, learner, seed=1, episodes=10, evaluate_every=5)
    assert result.runs[1].probability == [point.probability for point in training.history]
    with pytest.raises(SettingsError, match="Alternating has no setting 'turn'; did you mean turns"):
        dataclasses.replace(sweep, methods=(Method("own", Alternating, {"turn": 3}),)).runs()


def test_what_fails_is_told_and_the_others_go_on(write, tmp_path):
    bad = """
[[scenario]]
id = "outside"
task = "outside.stl"
[[scenario]]
id = "nowhere"
task = "nowhere.stl"
[[scenario]]
id = "short"
task = "outside.stl"
settings = { most_steps = 2 }
"""
    (tmp_path / "outside.stl").write_text(f'model "{FACTORY}/floor-5x5.toml"\nphi := (!B) U[0,3] A\n')
    (tmp_path / "nowhere.stl").write_text(f'model "{FACTORY}/floor-5x5.toml"\nphi := F[0,3] F[0,2] AA\n')
    result = stl.run_sweep(stl.load_sweep(write(TINY + bad)), tmp_path / "out", workers=1)
    assert {run.scenario for run in result.runs} == {"R", "C", "outside"}
    assert len(result.runs) == 8 + 2
    told = {(f.scenario, f.method, f.seed): f.message for f in result.failures}
    assert len(told) == len(result.failures) == 2 + 4 + 4
    assert "fragment" in told["outside", "naive", 1]
    assert "no label AA" in told["nowhere", "replay", 0]
    assert "most_steps is 2" in told["short", "replay", 0]
    assert [f.scenario for f in result.failures] == ["outside"] * 2 + ["nowhere"] * 4 + ["short"] * 4


def test_another_version_does_not_answer_for_this_one(write, tmp_path):
    sweep = stl.load_sweep(write())
    runs = [dataclasses.replace(run, version="0.0.1") for run in sweep.runs()]
    object.__setattr__(sweep, "runs", lambda: runs)
    result = stl.run_sweep(sweep, tmp_path / "out", workers=1)
    assert not result.runs
    assert all(
        "the sweep has 0.0.1; install the same version on both" in failure.message for failure in result.failures
    )


def test_a_faulty_learner_does_not_stop_the_sweep(write, tmp_path, monkeypatch):
    from stltool.learning import sweep as module

    def learn(product, name, **details):
        return 1 / 0 if details["seed"] else genuine(product, name, **details)

    genuine = module.learn
    monkeypatch.setattr(module, "learn", learn)
    result = stl.run_sweep(stl.load_sweep(write()), tmp_path / "out", workers=1)
    assert {run.seed for run in result.runs} == {0}
    assert {failure.seed for failure in result.failures} == {1}
    assert all("a bug in stltool" in f.message and "ZeroDivisionError" in f.message for f in result.failures)


def test_parts_of_a_sweep(write):
    sweep = stl.load_sweep(write())
    part = sweep.select(scenarios=["C"], methods=["replay"], seeds=3)
    assert [run.name for run in part.runs()] == [f"C replay seed {n}" for n in (0, 1, 2)]
    assert sweep.select(seeds=[7]).seeds == (7,)
    assert sweep.select().runs()[3].key == sweep.runs()[3].key
    with pytest.raises(SettingsError, match="no scenario 'c'; did you mean C"):
        sweep.select(scenarios=["c"])
    with pytest.raises(SettingsError, match="no method 'naive-er'"):
        sweep.select(methods=["naive-er"])
    for seeds in (0, -1, [], [1, 1], [True], [-1], [0.5]):
        with pytest.raises(SettingsError, match="different integers from 0"):
            sweep.select(seeds=seeds)


def test_one_sweep_at_a_time_in_a_folder(write, tmp_path):
    out, sweep = tmp_path / "out", stl.load_sweep(write())
    out.mkdir()
    with FileLock(out / "sweep.lock"), pytest.raises(FileError, match="another sweep is running there"):
        stl.run_sweep(sweep, out, workers=1)
    assert stl.run_sweep(sweep.select(["R"], ["naive"], 1), out, workers=1).skipped == 0  # the lock is free again
    with pytest.raises(SettingsError, match="workers is 0"):
        stl.run_sweep(sweep, out, workers=0)
    (tmp_path / "file").write_text("")
    with pytest.raises(FileError, match="cannot create the results folder"):
        stl.run_sweep(sweep, tmp_path / "file", workers=1)


@pytest.mark.soak(only=True)
def test_what_is_finished_and_how_long_the_rest_takes(write, tmp_path):
    sweep = stl.load_sweep(write())
    assert finished_runs(sweep, tmp_path / "none").runs == []
    seconds = estimated_seconds(sweep, tmp_path / "none")
    assert seconds.keys() == {(s, m) for s in "RC" for m in ("naive", "replay")}
    assert all(0 <= value < 60 for value in seconds.values())
    assert not (tmp_path / "none").exists()
    stl.run_sweep(sweep.select(["R"]), tmp_path / "some", workers=1)
    assert {key[0] for key in estimated_seconds(sweep, tmp_path / "some")} == {"C"}
    longer = stl.load_sweep(write(**{"episodes = 10": "episodes = 10000", "episodes = 12": "episodes = 20"}))
    estimate = estimated_seconds(longer, tmp_path / "none")
    assert estimate["R", "replay"] > 20 * estimate["C", "replay"] / 2


@pytest.mark.parametrize(
    ("old", "new", "error", "says"),
    [
        ("seeds = 2", "seeds = 0", SettingsError, "[sweep]: seeds is 0"),
        ("seeds = 2", "seeds = [1, 1]", SettingsError, "[sweep]: seeds is [1, 1]"),
        ("seeds = 2", "seeds = true", SettingsError, "[sweep]: seeds is True; it must be an integer or a list"),
        ("seeds = 2", "seed = 2", SettingsError, "[sweep]: unknown key seed; did you mean seeds?"),
        ("seeds = 2", "story = 1", SettingsError, "[sweep]: story is 1; it must be true or false"),
        ("seeds = 2", "columns = 0", SettingsError, "columns is 0"),
        ("seeds = 2", 'name = "../x"', SettingsError, "[sweep] name is '../x'; it names a folder"),
        ("[sweep]", "[swept]", SettingsError, "the file: unknown key swept; did you mean sweep?"),
        ("[sweep]", "[sweep", SettingsError, "not valid TOML"),
        ("evaluate_every = 5", "evaluate = 5", SettingsError,
         "[sweep], settings: none of the sweep's methods has a setting 'evaluate'; did you mean evaluate_every?"),
        ("evaluate_every = 5", "evaluate_every = 0", SettingsError, "[sweep], settings: evaluate_every is 0; it must"),
        ("evaluate_every = 5", "alpha = 2", SettingsError, "[sweep], settings: alpha is 2; it must be a number"),
        ("evaluate_every = 5", "replays = 2", SettingsError, "none of the sweep's methods has a setting 'replays'"),
        ("episodes = 12", "memory = 0", SettingsError, "scenario C, settings: memory is 0; it must be an integer"),
        ("batch = 8", "batch = [8]", SettingsError, "[[method]] 2, settings: batch is [8]"),
        ("batch = 8", "batch = true", SettingsError, "[[method]] 2, settings: batch is True; it must be an integer"),
        ("batch = 8", "gamma = 0.9", SettingsError, "[[method]] 2, settings: naive-er has no setting gamma; naive as"),
        ("batch = 8", "bach = 8", SettingsError, "[[method]] 2, settings: naive-er has no setting 'bach'; did you"),
        ('name = "naive-er"', 'name = "naive_er"', SettingsError, "[[method]] 2: there is no method 'naive_er'"),
        ('name = "naive-er"', 'name = "cfper"', SettingsError, "[[method]] 2: cfper exists only as published"),
        ('name = "naive-er"', "", SettingsError, "[[method]] 2 has no name"),
        ('id = "replay"', 'id = "Naive"', SettingsError, "two methods are called Naive"),
        ('id = "replay"', 'id = "a/b"', SettingsError, "[[method]] 2 id is 'a/b'"),
        ('id = "replay"', 'id = ".."', SettingsError, "[[method]] 2 id is '..'"),
        ("faithful = true", 'faithful = "yes"', SettingsError, "faithful is 'yes'; it must be true or false"),
        ('id = "C"', 'id = "r"', SettingsError, "two scenarios are called r"),
        ('id = "C"\n', "", SettingsError, "[[scenario]] 2 has no id"),
        ("published = { naive", "published = { nave", SettingsError,
         "scenario R, published: unknown key nave; did you mean naive?"),
        ("naive = 0.5", 'naive = "0.5"', SettingsError, "scenario R, published: naive is '0.5'; it must be"),
        ("params = { T", "param = { T", SettingsError, "scenario R: unknown key param; did you mean params?"),
        ("T = 4", "T = 'four'", SettingsError, "scenario R: param T: 'four' is not a number"),
        ("{ T = 4", "{ TT = 4", StlToolError, "TT"),
        ("charging.stl", "charge.stl", FileError, "scenario C: "),
        ('id = "C"', f'id = "C"\nmodel = "{FACTORY}/floor.toml"', FileError, "there is no such model file"),
        ('id = "C"', 'id = "C"\ndefinition = "charge"', StlToolError, "charge"),
        ("[[scenario]]", "[[scenarios]]", SettingsError, "unknown key scenarios; did you mean scenario?"),
    ],
)  # fmt: skip
def test_what_is_wrong_in_a_file_is_named(write, old, new, error, says):
    path = write(**{old: new})
    with pytest.raises(error) as caught:
        stl.load_sweep(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert says in str(caught.value)


def test_files_that_are_no_sweeps(write, tmp_path):
    with pytest.raises(FileError, match="no such sweep file"):
        stl.load_sweep(tmp_path / "none.toml")
    with pytest.raises(SettingsError, match="has no sweep; add it"):
        stl.load_sweep(write("[[method]]\nname = 'cfer'\n"))
    with pytest.raises(SettingsError, match="has no scenario; add it"):
        stl.load_sweep(write(TINY.split("[[scenario]]")[0]))
    with pytest.raises(SettingsError, match=r"method is \[\]; write one or more tables \[\[method\]\]"):
        stl.load_sweep(write("method = []\n[sweep]\n[[scenario]]\nid = 'R'\n"))
    (tmp_path / "bare.stl").write_text("phi := F[0,3] A\n")
    with pytest.raises(SettingsError, match="scenario bare: neither the scenario nor its task file names a model"):
        stl.load_sweep(write(TINY + '[[scenario]]\nid = "bare"\ntask = "bare.stl"\n'))


def test_paths_are_relative_to_the_file(write, tmp_path, monkeypatch):
    (tmp_path / "t.stl").write_text("phi := F[0,3] A\n")
    (tmp_path / "floor.toml").write_bytes((FACTORY / "floor-5x5.toml").read_bytes())
    path = write(TINY + '[[scenario]]\nid = "here"\ntask = "t.stl"\nmodel = "floor.toml"\n')
    monkeypatch.chdir("/")
    assert stl.load_sweep(path).scenarios[2].model.n_states == 18


def test_results_of_a_run_are_plain_json(write, tmp_path):
    stl.run_sweep(stl.load_sweep(write()).select(["R"], ["naive"], 1), tmp_path, workers=1)
    content = json.loads((tmp_path / "runs/R/naive/seed-0.json").read_text())
    assert (content["format"], content["episode"], content["steps"][-1]) == ("stltool-run-1", [5, 10], 10 * 7)
    assert len(content["key"]) == len(content["policy"]) == 64


def test_a_missing_name_in_a_model_is_found_by_products(write, tmp_path):
    (tmp_path / "t.stl").write_text(f'model "{FACTORY}/floor-5x5.toml"\nphi := F[0,3] AA\n')
    sweep = stl.load_sweep(write(TINY + '[[scenario]]\nid = "x"\ntask = "t.stl"\n'))
    with pytest.raises(NameLookupError, match="AA"):
        _ = sweep.scenarios[2].product


@pytest.mark.parametrize("change", [
    {"probability": lambda p: [7.5] * len(p)}, {"probability": lambda p: ["<b>"] * len(p)},
    {"probability": lambda p: p[1:]}, {"steps": lambda steps: steps[::-1]}, {"seed": lambda seed: seed + 1},
    {"episode": lambda e: [-1, *e[1:]]}, {"episode": lambda e: e[0]}, {"policy": lambda digest: 3},
    {"extra": lambda _: 1},
    {"steps": lambda steps: [True] * len(steps)}, {"probability": lambda p: [float("nan")] * len(p)},
])  # fmt: skip
@pytest.mark.parametrize("signed", [False, True])
def test_a_run_that_cannot_be_is_told_and_run_again(write, tmp_path, change, signed):
    """Whether or not whoever changed it changed the digest, too."""
    out, sweep = tmp_path / "out", stl.load_sweep(write()).select(seeds=[0])
    stl.run_sweep(sweep, out, workers=1)
    whole = files(out)
    place = out / "runs" / "C" / "replay" / "seed-0.json"
    content = json.loads(place.read_text())
    for name, changed in change.items():
        content[name] = changed(content.get(name))
    if signed:
        found = {name: value for name, value in content.items() if name not in ("format", "key", "digest")}
        content["digest"] = stored._digest(found)
    place.write_text(json.dumps(content))
    result = stl.run_sweep(sweep, out, workers=1)
    assert result.damaged == [str(place)]
    assert result.skipped == len(sweep.runs()) - 1
    assert files(out) == whole
