"""The induction in blocks, on a dask cluster: the same bits as on one machine."""

import os
import signal
from concurrent.futures import CancelledError
from types import SimpleNamespace

import numpy as np
import pytest

import stltool as stl
from stltool.automata import FALSE, TRUE
from stltool.checking.fixed import fixed_point
from stltool.checking.induction import EVERYTHING, Budget, Doubles, Fixed, Following, Game, induct, solve_on_cluster
from stltool.checking.induction.recording import InMemory
from stltool.cluster import _require_workers, connected, this_version
from stltool.errors import PolicyError, SettingsError, SizeError
from tests.checking.test_induction import random_policy, random_product
from tests.conftest import MORE, many

distributed = pytest.importorskip("distributed")


class AtOnce:
    """Stands for a client: what is submitted is done at once."""

    class Future:
        def __init__(self, value):
            self.value = value

        def result(self):
            return self.value

    def submit(self, task, *given, pure, workers=None, allow_other_workers=None):
        assert not pure
        return self.Future(task(*(self.resolved(value) for value in given)))

    def resolved(self, value):
        if isinstance(value, list):
            return [self.resolved(part) for part in value]
        return value.value if isinstance(value, self.Future) else value

    def gather(self, futures):
        return self.resolved(futures)

    def nthreads(self):
        return {"here": 1}


@pytest.mark.soak
@pytest.mark.parametrize("seed", range(many(20)))
def test_blocks_give_the_same_bits(seed):
    product, rng = random_product(seed, most_states=40)
    fixed = fixed_point(product.model)
    game = Game.of(product, everywhere=bool(seed % 2))
    for maximize in (True, False):
        goal = TRUE if maximize else FALSE
        for policy in (None, random_policy(product, rng, "timed"), random_policy(product, rng, "stationary")):
            allowed, keep = (EVERYTHING, np.uint8) if policy is None else (Following(policy.form), None)
            for arithmetic in (
                Doubles(maximize),
                Fixed(fixed.denominator, fixed.one, maximize),
            ):
                whole = induct(game, arithmetic, maximize, allowed, engine="words", keep=keep)
                parts = solve_on_cluster(
                    AtOnce(), game, arithmetic, goal, allowed, keep, None, Budget("a test"), n_blocks=1 + seed % 7
                )
                assert np.array_equal(parts.entry, whole.entry)
                assert parts.entry.dtype == whole.entry.dtype
                assert np.array_equal(parts.certain, whole.certain)
                if policy is None:
                    for t in range(game.horizon):
                        assert np.array_equal(parts.choices.row(t), whole.choices.row(t)), t


def test_steps_that_repeat_are_left_out_in_blocks_too():
    product, _ = random_product(5, most_states=30, formula="F[0,100000] (a & b)")
    game, arithmetic = Game.of(product), Doubles(True)
    whole = induct(game, arithmetic, engine="words", keep=np.uint8)
    parts = solve_on_cluster(AtOnce(), game, arithmetic, TRUE, EVERYTHING, np.uint8, None, Budget("a test"), 3)
    assert 0 < parts.swept < 2000
    assert np.array_equal(parts.entry, whole.entry)
    assert all(np.array_equal(parts.choices.row(t), whole.choices.row(t)) for t in (0, 1, 50_000, 99_998, 99_999))


def test_steps_that_repeat_twice_are_left_out_in_blocks_too():
    """What was asked for ahead of them is of no use then."""
    product, _ = random_product(1, most_states=12, formula="F[5,5] (a | F[1,2] b)")
    game, arithmetic = Game.of(product), Doubles(True)
    whole = induct(game, arithmetic, engine="words", keep=np.uint8)
    parts = solve_on_cluster(AtOnce(), game, arithmetic, TRUE, EVERYTHING, np.uint8, None, Budget("a test"), 3)
    assert parts.swept == whole.swept == 7
    assert np.array_equal(parts.entry, whole.entry)
    assert all(np.array_equal(parts.choices.row(t), whole.choices.row(t)) for t in range(game.horizon))


def test_what_fails_in_blocks_is_not_kept_as_if_it_were_whole():
    closed = []

    class Full(InMemory):
        def add(self, listed):
            raise OSError("no space left")

        def close(self, whole):
            closed.append(whole)

    game = Game.of(random_product(1, most_states=12, formula="F[5,5] (a | F[1,2] b)")[0])
    with pytest.raises(OSError, match="no space left"):
        solve_on_cluster(AtOnce(), game, Doubles(True), TRUE, EVERYTHING, np.uint8, Full(), Budget("a test"), 3)
    assert closed == [False]


def local(**kind):
    """A cluster on this machine; without an address for its pages it takes port 8787, if that is free."""
    return distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=":0", silence_logs=50, protocol="tcp://", **kind
    )


@pytest.fixture(scope="module")
def processes():
    with local() as made:
        yield made


@pytest.fixture(scope="module", params=["threads", *(["processes"] if MORE > 1 else [])])
def cluster(request):
    """Workers of this process, to which all is sent as to others; in `make soak` those of others, too."""
    if request.param == "processes":
        yield request.getfixturevalue("processes")
    else:
        with local(processes=False) as made:
            yield made


@pytest.fixture(scope="module")
def patrolling():
    params = {"T": 3, "tau": 6} if MORE > 1 else {"T": 2, "tau": 4}
    task = stl.load_task("examples/factory/patrolling.stl", params=params)
    return stl.build_product(stl.load_model(task.model), task)


@pytest.mark.soak(only=True)
def test_a_check_on_workers(cluster, patrolling, tmp_path):
    address = cluster.scheduler_address
    for maximize in (True, False):
        for arithmetic in ("double", "fixed"):
            settings = {"maximize": maximize, "arithmetic": arithmetic}
            here, there = stl.check(patrolling, **settings), stl.check(patrolling, **settings, cluster=address)
            assert (there.probability, there.lower, there.upper) == (here.probability, here.lower, here.upper)
            assert there.engine == "cluster"
    kept = stl.check(patrolling, cluster=address, policy_file=tmp_path / "best.policy").policy
    assert isinstance(kept, stl.Policy)
    here = stl.check(patrolling, engine="words")
    assert stl.check(patrolling, kept, cluster=address).probability == here.probability
    assert all(np.array_equal(kept.row(t), here.policy.row(t)) for t in range(patrolling.horizon))


@pytest.mark.soak(only=True)
@pytest.mark.parametrize("arithmetic", ["fixed", pytest.param("double", marks=pytest.mark.soak(only=True))])
def test_a_certificate_by_workers_is_the_same_file(arithmetic, cluster, patrolling, tmp_path, monkeypatch):
    if arithmetic == "double":
        monkeypatch.setattr("stltool.checking.proof.fixed_point", lambda *_: None)
    policy = stl.check(patrolling, maximize=False).policy
    for result in (stl.check(patrolling), stl.check(patrolling, maximize=False), stl.check(patrolling, policy)):
        here, there = tmp_path / "here.jsonl", tmp_path / "there.jsonl"
        bounds = stl.write_certificate(result, here)
        assert stl.write_certificate(result, there, cluster=cluster.scheduler_address) == bounds
        assert there.read_bytes() == here.read_bytes()
    with pytest.raises(SettingsError, match="does not run on a cluster"):
        stl.write_certificate(stl.check(patrolling, exact=True), tmp_path / "c.jsonl", cluster="tcp://here:1")


@pytest.mark.soak(only=True)
def test_a_killed_worker_is_survived(processes, patrolling):
    killed = []

    def progress(done, total):
        if not killed and done > total * 0.7:  # on its way back
            with distributed.Client(processes, set_as_default=False) as client:
                pids = client.run(os.getpid)
            killed.append(min(pids.values()))
            os.kill(killed[0], signal.SIGKILL)

    here = stl.check(patrolling, arithmetic="double")
    there = stl.check(patrolling, arithmetic="double", cluster=processes.scheduler_address, progress=progress)
    assert len(killed) == 1
    assert (there.probability, there.lower, there.upper) == (here.probability, here.lower, here.upper)
    assert all(np.array_equal(there.policy.row(t), here.policy.row(t)) for t in range(patrolling.horizon))


def test_where_a_policy_is_silent_a_worker_says_so(cluster, patrolling):
    table = np.full(patrolling.shape, -1)
    policy = stl.Policy(patrolling, table)
    with pytest.raises(PolicyError, match="defines no action at"):
        stl.check(patrolling, policy, cluster=cluster.scheduler_address)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"exact": True}, "exact=True does not run on a cluster; leave cluster out"),
        ({"engine": "words"}, "engine=… does not run on a cluster"),
        ({"threads": 2}, "threads=… does not run on a cluster"),
        ({"resume": True, "policy_file": "best.policy"}, "resume=True does not run on a cluster"),
        ({"policy": "mixing"}, "a policy that mixes actions does not run on a cluster"),
        ({}, "no dask scheduler answers at nowhere"),
    ],
)
def test_what_a_cluster_does_not_do(settings, message, patrolling, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    if settings.get("policy"):
        settings = {"policy": stl.Policy(patrolling, np.full((*patrolling.shape, 9), 1 / 9))}
    with pytest.raises(SettingsError, match=message):
        stl.check(patrolling, **settings, cluster="nowhere")


@pytest.mark.parametrize(
    ("error", "kind", "message"),
    [
        (
            distributed.KilledWorker("back", SimpleNamespace(address="tcp://here:1"), 3),
            SizeError,
            "more memory, or use more workers",
        ),
        (CancelledError("gone"), SettingsError, "was lost: gone"),
    ],
)
def test_what_goes_wrong_on_a_cluster_is_told(error, kind, message, cluster):
    with pytest.raises(kind, match=message), connected(cluster.scheduler_address, "a check", "leave it out"):
        raise error


def test_a_scheduler_without_workers_is_told():
    def wait_for_workers(n, timeout):
        raise TimeoutError

    client = SimpleNamespace(wait_for_workers=wait_for_workers)
    with pytest.raises(SettingsError, match=r"tcp://s:1 has no workers; start some: dask worker tcp://s:1"):
        _require_workers(client, "tcp://s:1")


@pytest.mark.parametrize(
    ("found", "message"),
    [
        ("0.0.9 (another)", r"the dask worker at tcp://b:2 has stltool 0\.0\.9 \(another\), not stltool .* as here"),
        (ModuleNotFoundError("No module named 'stltool'"), r"has no stltool \(No module named 'stltool'\)"),
    ],
)
def test_workers_of_another_version_are_refused(found, message):
    versions = {"tcp://a:1": this_version(), "tcp://b:2": found}
    client = SimpleNamespace(wait_for_workers=lambda n, timeout: None, run=lambda task, on_error: versions)
    with pytest.raises(SettingsError, match=message):
        _require_workers(client, "tcp://s:1")
