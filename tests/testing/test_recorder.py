"""Recorders: their verdicts are those of `monitor` on what was recorded, raised as soon as they are certain."""

import asyncio
import inspect
import time

import gymnasium
import numpy as np
import pytest

import stltool as stl
from stltool.testing import Recorder, TraceViolation, recorded, recorded_env
from tests.conftest import many

FORMULAS = [
    "G[0,5] (x > -1.5)", "F[0,4] (x > 1 & a)", "(x > -1) U[0,6] a", "a -> F[1,3] (x < 0)", "!(F[0,3] a) | G[2,4] a",
    "(F[0,3] a) & (G[0,3] !a)", "once[0,2] (x > 1)", "G[0,4] (rise a -> F[0,2] (x[t+1] > x))", "x > 0", "true",
    "historically (x > -2) & F[0,3] a",
]  # fmt: skip


def trace_of(rng, n):
    return {"x": rng.normal(size=n), "a": rng.random(n) < 0.5}


def samples(trace):
    return [{name: column[t] for name, column in trace.items()} for t in range(len(trace["x"]))]


@pytest.mark.parametrize("end", ["error", "cut", "hold"])
@pytest.mark.parametrize("online", [True, False])
@pytest.mark.parametrize("text", FORMULAS)
def test_the_verdict_is_that_of_the_monitor(text, online, end):
    rng, phi = np.random.default_rng(0), stl.parse(text, unbounded=True)
    for _ in range(many(15)):
        trace = trace_of(rng, 9 if end == "error" else int(rng.integers(1, 10)))
        expected = bool(stl.monitor(phi, trace, end, "boolean", at=0).verdicts[0])
        record, raised = Recorder(phi, online=online, end=end), False
        try:
            with record:
                for sample in samples(trace):
                    record(sample)
        except TraceViolation as error:
            raised, told = True, str(error)
            assert "fails at step 0" in told
        if record.decided_at is not None and record.n_steps < len(trace["x"]):
            assert not record.verdict  # left early
        if end == "error" or record.n_steps == len(trace["x"]):
            assert record.verdict == expected or record.decided_at < len(trace["x"])
        else:
            assert record.decided_at == record.n_steps
        if end != "cut":  # a held sample is one of the continuations
            assert record.verdict == expected
        assert raised == (not record.verdict)


def test_a_violation_is_raised_with_the_sample_that_makes_it_certain():
    with pytest.raises(TraceViolation, match=r"x > 0 fails at step 2 with x = 0") as raised:  # noqa: SIM117, PT012
        with Recorder("G[0,1000] (x > 0)") as record:
            for t in range(2000):
                record(x=2.0 - t)
    assert record.n_steps == record.decided_at == 3
    assert record.trace["x"].tolist() == [2, 1, 0]
    assert not raised.value.diagnosis.verdict


def test_always_without_an_end_is_judged_as_it_runs():
    record = Recorder("G (a -> F[0,2] b) & G (x > 0)")
    with pytest.raises(TraceViolation):  # noqa: SIM117, PT012
        with record:
            for t in range(100):
                record(x=1, a=t == 10, b=False)
    assert record.decided_at == 13


def test_a_block_is_left_once_the_verdict_is_certain():
    with Recorder("F[0,50] (x > 3)", stop=True) as record:
        for t in range(100):
            record(x=t)
        raise AssertionError("not reached")
    assert (record.verdict, record.n_steps) == (True, 5)


def test_without_online_the_program_runs_to_its_end():
    record = Recorder("G[0,5] (x > 0)", online=False)
    with pytest.raises(TraceViolation):  # noqa: SIM117, PT012
        with record:
            for t in range(8):
                assert record(x=1.0 - t) is None
    assert record.n_steps == 8


def test_an_error_of_the_program_goes_through():
    with pytest.raises(KeyError), Recorder("G[0,5] (x > 0)") as record:  # noqa: PT012
        record(x=1)
        raise KeyError("x")
    assert record.verdict is None


@pytest.mark.parametrize(
    ("use", "message"),
    [
        (lambda: Recorder(3), "Recorder's formula is 3"),
        (lambda: Recorder("x > 0", every=0.1), "every takes samples by `read`, which is not given"),
        (lambda: Recorder("x > 0", dict, every=0), "every is 0; give seconds above 0"),
        (lambda: Recorder("x > 0", end="open"), "end is 'open'; choose error, cut or hold"),
        (lambda: Recorder("x > 0")(y=1), "sample 0: x is missing, which the formula reads"),
        (lambda: Recorder("x > 0")(), "record\\(\\) has no sample"),
        (lambda: Recorder("x > 0")(x="far"), "x"),
        (lambda: Recorder("x > 0")([1]), "record's sample are .*, not a mapping"),
        (lambda: Recorder("x > 0").close(), "nothing was recorded"),
        (lambda: [record := Recorder("F[0,2] (x > 0)"), record(x=1, y=2), record(x=1)], "sample 1: y is not in every"),
        (lambda: [record := Recorder("F[0,2] (x > 0)", online=False), record(x=1), record.close()], "needs 3"),
        (lambda: [record := Recorder("x > 0"), record(x=1), record.close(), record(x=1)], "after the recorder's block"),
    ],
)
def test_bad_use_is_told(use, message):
    with pytest.raises(stl.StlToolError, match=message):
        use()


# -------------------------------------------------------------------------------------------------------- decorator


def test_the_decorator_gives_each_call_a_recorder_and_hides_it_from_pytest():
    @recorded("G[0,2] (x < limit)")
    def run(record, values, limit=5):
        for value in values:
            record(x=value, limit=limit)
        return len(values)

    assert list(inspect.signature(run).parameters) == ["values", "limit"]
    assert run([1, 2, 3]) == 3
    with pytest.raises(TraceViolation):
        run([1, 2, 7])
    assert run([1, 2, 7], limit=8) == 3


def test_the_decorator_takes_coroutines():
    @recorded("F[0,2] (x > 1)")
    async def run(record):
        for value in (0, 1, 2):
            await asyncio.sleep(0)
            record(x=value)
        return "done"

    assert asyncio.run(run()) == "done"


# ---------------------------------------------------------------------------------------------- samples by themselves


def test_a_violation_cancels_an_asyncio_block():
    level = {"x": 1.0}

    async def service():
        async with Recorder("G[0,500] (x > 0)", lambda: level, every=0.005) as record:
            await asyncio.sleep(0.03)
            level["x"] = -1.0
            await asyncio.sleep(60)
        return record

    start = time.monotonic()
    with pytest.raises(TraceViolation):
        asyncio.run(service())
    assert time.monotonic() - start < 30


def test_an_asyncio_block_is_left_once_the_verdict_is_certain_and_its_task_goes_on():
    async def service():
        async with Recorder("F[0,500] (x > 0)", lambda: {"x": 1}, every=0.005, stop=True) as record:
            await asyncio.sleep(60)
        await asyncio.sleep(0)  # not cancelled
        return record.verdict

    assert asyncio.run(service())


def test_a_cancellation_from_outside_is_not_swallowed():
    async def service():
        async with Recorder("G[0,500] (x > 0)", lambda: {"x": 1}, every=0.005):
            await asyncio.sleep(60)

    async def outside():
        task = asyncio.create_task(service())
        await asyncio.sleep(0.02)
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task

    asyncio.run(outside())


def test_a_thread_samples_a_block():
    record = Recorder("F[0,3] (x > 2)", lambda: {"x": time.monotonic()}, every=0.005, end="hold")
    with record:
        time.sleep(0.03)
    assert record.verdict
    assert record.n_steps >= 2
    values = record.trace["x"]
    assert (np.diff(values) > 0).all()
    with pytest.raises(TraceViolation), Recorder("G[0,3] (x > 2)", lambda: {"x": 1}, every=0.005):
        time.sleep(0.02)


# --------------------------------------------------------------------------------------------------------- Gymnasium


class Walk(gymnasium.Env):
    """Moves by the action, ends at 4."""

    observation_space = gymnasium.spaces.Box(-10, 10, (1,))
    action_space = gymnasium.spaces.Discrete(3)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.x = 0.0
        return np.array([self.x], dtype=np.float32), {}

    def step(self, action):
        self.x += float(action) - 1
        return np.array([self.x], dtype=np.float32), 0.0, self.x >= 4, False, {"kept": 1}


SIGNALS = {"x": lambda observation: float(observation[0])}


def test_an_environment_ends_when_its_verdict_is_certain():
    env = recorded_env(Walk(), "F[0,9] (x >= 2)", SIGNALS)
    assert env.reset(seed=0)[1] == {"stl": None}
    assert env.step(2)[2:] == (False, False, {"kept": 1, "stl": None})
    assert env.step(2)[2:] == (False, True, {"kept": 1, "stl": True})
    env.reset()
    assert env.record.n_steps == 1


def test_a_violation_in_an_environment_is_raised_or_truncates():
    env = recorded_env(Walk(), "G[0,9] (x >= 0)", SIGNALS)
    env.reset()
    with pytest.raises(TraceViolation, match="x >= 0 fails at step 1 with x = -1"):
        env.step(0)
    env = recorded_env(Walk(), "G[0,9] (x >= 0)", SIGNALS, raises=False)
    env.reset()
    assert env.step(0)[3:] == (True, {"kept": 1, "stl": False})
    assert env.record.trace["x"].tolist() == [0, -1]


def test_an_episode_that_ends_is_judged_as_if_it_stayed():
    env = recorded_env(Walk(), "F[5,9] (x >= 4)", SIGNALS)
    env.reset()
    steps = [env.step(2) for _ in range(4)]
    assert steps[-1][2:] == (True, True, {"kept": 1, "stl": True})
