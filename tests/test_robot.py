"""examples/robot: what the plants, the controller and the tables do; the physical ones where MuJoCo is installed."""

import time
from importlib.util import find_spec

import numpy as np
import pytest

import stltool as stl
from examples.robot.__main__ import main, physics
from examples.robot.controller import NOISE, Noise, Robots
from examples.robot.fleet import Fleet, black_box
from examples.robot.floor import HALF, STEPS, Oil, factory
from examples.robot.kinematic import RADIUS, Kinematic
from examples.robot.walk import SECTORS, Walk, by_action_before, by_heading, predicted, random_walk, table

DRY = factory(())
PLANTS = [
    Kinematic,
    pytest.param(physics, marks=pytest.mark.skipif(not find_spec("mujoco"), reason="MuJoCo is not installed")),
]


def cell_at(x, y):
    return int(DRY.cells(np.array([[x, y]]))[0])


def test_cells_are_the_models_states():
    for s, (x, y) in enumerate(DRY.centres):
        assert (DRY.nominal.signals["x"][s], DRY.nominal.signals["y"][s]) == pytest.approx((x / 5, y / 5))
    assert DRY.cells(DRY.centres).tolist() == list(range(DRY.nominal.n_states))
    assert DRY.cells(np.array([[0.9, 1.6]])).tolist() == [cell_at(1.5, 1.5)]  # on a wall: the free cell next to it


def test_moves_aim_where_the_nominal_model_leads_most_often():
    model = DRY.nominal
    for choice in range(model.n_choices):
        s, a = divmod(choice, len(model.action_names))
        row = slice(model.row_start[choice], model.row_start[choice + 1])
        assert DRY.target[s, a] == model.target[row][model.probability[row].argmax()]


@pytest.mark.parametrize("make_plant", PLANTS)
def test_quiet_moves_end_in_their_cells(make_plant):
    ids, start = np.arange(9), cell_at(2.5, 2.5)
    robots = Robots(make_plant(DRY, 9), np.random.default_rng(), Noise.none())
    robots.place(ids, start)
    track = []
    robots.move(ids, ids, track)
    assert len(track) == 60
    assert robots.cells(ids).tolist() == DRY.target[start].tolist()
    away = np.hypot(*(robots.plant.pose(ids)[:, :2] - DRY.centres[DRY.target[start]]).T)
    assert (away < 0.15).all()


def success(make_plant, floor, n, noise=NOISE, starts=None):
    """The share of moves from random cells towards another one that end there; from all cells, or some."""
    rng = np.random.default_rng()
    cell, action = np.nonzero(floor.target != np.arange(len(floor.target))[:, None])
    if starts is not None:
        cell, action = (one[np.isin(cell, starts)] for one in (cell, action))
    chosen = rng.integers(0, len(cell), n)
    robots, ids = Robots(make_plant(floor, n), rng, noise), np.arange(n)
    robots.place(ids, cell[chosen], rng.uniform(-np.pi, np.pi, n))
    robots.move(ids, action[chosen])
    return (robots.cells(ids) == floor.target[cell[chosen], action[chosen]]).mean()


@pytest.mark.soak(only=True)
@pytest.mark.parametrize("make_plant", PLANTS)
def test_noisy_moves_mostly_succeed(make_plant):
    """Rates over many moves are .90 and .94; 200 moves are off by .12 once in 10⁷ times."""
    assert 0.78 < success(make_plant, DRY, 200) < 1


def test_who_begins_on_oil_slips():
    oily = factory((Oil(2.5, 2.5, 0.35),))
    here, elsewhere = cell_at(2.5, 2.5), [cell_at(0.5, 4.5), cell_at(4.5, 4.5), cell_at(4.5, 0.5)]
    careful = Noise(slip=0, oil=1)
    assert success(Kinematic, oily, 300, careful, starts=[here]) < 0.7
    assert success(Kinematic, DRY, 300, careful, starts=[here]) > 0.9
    assert success(Kinematic, oily, 300, careful, starts=elsewhere) > 0.9


def test_robots_stay_on_the_floor_and_out_of_walls():
    n = 200
    fleet = Fleet(Kinematic(factory(), n), np.random.default_rng())
    fleet.reset(n)
    for _ in range(3):
        track = []
        fleet.robots.move(np.arange(n), np.random.default_rng().integers(0, 9, n), track)
        xy = np.array(track)[..., :2]
        assert (xy >= RADIUS - 1e-9).all()
        assert (xy <= 5 - RADIUS + 1e-9).all()
        gap = np.abs(xy[:, :, None] - DRY.blocks) - HALF
        assert (np.hypot(*np.moveaxis(np.maximum(gap, 0), -1, 0)) >= RADIUS - 1e-3).all()


def test_resting_robots_do_not_move_and_seeds_repeat():
    ends = []
    for _ in range(2):
        fleet = Fleet(Kinematic(factory(), 6), np.random.default_rng(3))
        assert fleet.reset(4).tolist() == [DRY.start] * 4
        fleet.step(np.array([1, 7, -1, 4]))
        assert fleet.robots.plant.pose(np.array([2])).tolist() == [[*DRY.centres[DRY.start], 0]]
        ends.append(fleet.robots.plant.pose(np.arange(4)))
    assert np.array_equal(*ends)
    assert (ends[0][[0, 1, 3], :2] != DRY.centres[DRY.start]).any(axis=1).all()


def test_many_robots_at_once_are_fast():
    """Moves a second, a thousand side by side against one by one."""

    def rate(n, moves):
        fleet = Fleet(Kinematic(factory(), n), np.random.default_rng(0))
        fleet.reset(n)
        start = time.process_time()
        for _ in range(moves):
            fleet.step(np.full(n, 7))
        return n * moves / (time.process_time() - start)

    assert rate(1000, 1) > 50 * max(rate(1, 2) for _ in range(3))


# ------------------------------------------------------------------------------------------------------------- tables


@pytest.fixture(scope="module")
def walk():
    return random_walk(Fleet(Kinematic(factory(), 500), np.random.default_rng(0)), np.random.default_rng(1), 6, every=4)


def test_a_walk_is_a_chain(walk):
    n = 500
    for one in range(n):
        robot = slice(one, None, n)
        cell, sector, before = (part[robot].tolist() for part in (walk.cell, walk.sector, walk.before))
        after = walk.next_cell[robot].tolist()
        for k in range(6):
            if k % 4 == 0:
                assert (cell[k], sector[k], before[k]) == (DRY.start, 0, 0)
            else:
                assert (cell[k], sector[k]) == (after[k - 1], walk.next_sector[robot][k - 1])
                assert before[k] == walk.action[robot][k - 1] + 1
    assert len(walk) == 6 * n
    assert 0 < (walk.sector > 0).mean() < 1


@pytest.mark.parametrize("heading", [False, True])
def test_tables_are_relative_frequencies(walk, heading):
    model, never = table(walk, heading)
    kinds = SECTORS if heading else 1
    here = walk.cell * kinds + walk.sector * heading
    there = walk.next_cell * kinds + walk.next_sector * heading
    tried = set(zip(here.tolist(), walk.action.tolist(), strict=True))
    assert never == model.n_choices - len(tried)
    for s, a in list(tried)[:200]:
        mine = (here == s) & (walk.action == a)
        row = slice(*model.row_start[s * 9 + a :][:2])
        shares = dict(zip(model.target[row].tolist(), model.probability[row].tolist(), strict=True))
        assert shares == pytest.approx({t: (there[mine] == t).mean() for t in set(there[mine].tolist())})


def test_contexts_of_the_markov_tests(walk):
    for counts, context, state in (
        (by_heading(walk), walk.sector, walk.cell),
        (by_action_before(walk), walk.before, walk.cell),
        (by_action_before(walk, heading=True), walk.before, walk.cell * SECTORS + walk.sector),
    ):
        rows = np.stack([state * 9 + walk.action, walk.next_cell, context])
        expected, seen = np.unique(rows, axis=1, return_counts=True)
        assert np.array_equal(np.stack(counts.in_context), [*expected, seen])


def test_a_cell_that_hides_a_heading_is_refuted_and_a_shown_one_is_not():
    """A walk made by hand: the move east succeeds with .9 for robots that look east, with .5 for others."""
    rng, n = np.random.default_rng(0), 4000
    east = int(list(STEPS).index("E"))
    cell, sector = np.full(n, DRY.start), rng.integers(0, SECTORS, n)
    works = rng.random(n) < np.where(sector == 0, 0.9, 0.5)
    before = np.where(sector == 0, 1, rng.integers(2, 10, n))  # what it did before is why it looks there
    walk = Walk(DRY, cell, sector, np.full(n, east), before, np.where(works, cell_at(2.5, 1.5), cell), sector)
    assert stl.markov_test(by_heading(walk), draws=1999, confidence=0.999).rejected
    assert stl.markov_test(by_action_before(walk), draws=1999, confidence=0.999).rejected
    shown = stl.markov_test(by_action_before(walk, heading=True), draws=1999, confidence=0.999)
    assert not shown.rejected


def test_a_table_that_forgets_nothing_predicts_like_the_model():
    nominal = DRY.nominal
    product = stl.build_product(nominal, stl.parse("F[0,3] A"))
    policy = stl.check(product).policy
    assert predicted(stl.Policy(product, np.maximum(policy.table, 0)), nominal) == stl.check(product).probability


# --------------------------------------------------------------------------------------------------- the whole story


def test_the_story_runs(tmp_path, capsys):
    options = ["--plant", "kinematic", "--window", 5, "--robots", 60, "--moves", 360, "--episodes", 10, "--runs", 60]
    assert main([*map(str, options), "--out", str(tmp_path)]) == 0
    out = capsys.readouterr().out
    page = (tmp_path / "robot.html").read_text(encoding="utf-8")
    lines = [line for line in out.splitlines() if line.startswith(("optimum of", "learned on"))]
    assert len(lines) == 3
    for line in lines:
        assert line.split("  ")[-1] in page
    assert lines[0].split()[5] == "0.7379"  # of the nominal model's optimum, by itself
    assert page.count("data:image/png;base64,") == 2
    assert (tmp_path / "report.html").exists()
    assert "is a state: the cell, given the heading: " in out


def test_learning_from_a_fleet_gives_a_policy_that_fresh_runs_judge():
    model = black_box(DRY, lambda: Kinematic(DRY, 20))
    product = stl.build_product(model, stl.parse("F[0,4] A"))
    run = stl.learn(product, "model-based", episodes=20, evaluate_every=20, seed=0)
    assert stl.estimate(product, run.policy, runs=60).probability > 0.6
    again = stl.learn(product, "model-based", episodes=20, evaluate_every=20, seed=0)
    assert np.array_equal(again.policy.table, run.policy.table)


@pytest.mark.parametrize("options", [["--runs", "0"], ["--episodes", "x"], ["--seed", "-1"], ["--plant", "car"]])
def test_options_that_cannot_be(options, capsys):
    with pytest.raises(SystemExit) as stopped:
        main(options)
    assert stopped.value.code == 2
    assert options[0] in capsys.readouterr().err


def test_a_folder_that_cannot_be_written_is_refused_before_the_work(tmp_path, capsys):
    (tmp_path / "file").write_text("")
    assert main(["--plant", "kinematic", "--out", str(tmp_path / "file" / "out")]) == 2
    assert "not a writable directory" in capsys.readouterr().err


@pytest.mark.skipif(not find_spec("mujoco"), reason="MuJoCo is not installed")
def test_a_rendered_floor_lies_under_the_track():
    plant = physics(factory(), 1)
    from examples.robot.physics import picture

    plant.place(np.array([0]), np.array([[1.5, 0.5, 0.0]]))
    try:
        pixels, (left, right, bottom, top) = picture(plant, 0, 300)
    except Exception as error:  # MuJoCo raises whatever the graphics driver does
        pytest.skip(f"there is no OpenGL: {error}")
    colour = pixels.astype(int)

    def at(x, y):
        return colour[int((top - y) / (top - bottom) * 300), int((x - left) / (right - left) * 300)]

    assert at(1.5, 0.57)[0] > at(1.5, 0.57)[2] + 60  # the robot is yellow
    assert at(4.5, 0.5)[2] > at(4.5, 0.5)[0] + 40  # A is blue
    assert at(2.5, 1.5).max() < at(2.5, 2.5).min()  # oil is dark


@pytest.mark.skipif(not find_spec("mujoco"), reason="MuJoCo is not installed")
def test_the_kinematic_robots_move_like_the_physical_ones():
    """The row of a choice, on the dry floor: some .1 apart, of which .07 may be chance."""
    rows = []
    for make_plant, n in ((Kinematic, 1500), (physics, 120)):
        robots, ids = Robots(make_plant(DRY, n), np.random.default_rng()), np.arange(n)
        robots.place(ids, DRY.start, np.random.default_rng().uniform(-np.pi, np.pi, n))
        robots.move(ids, np.full(n, list(STEPS).index("NE")))
        rows.append(np.bincount(robots.cells(ids), minlength=18) / n)
    assert abs(rows[0] - rows[1]).sum() / 2 < 0.25


@pytest.mark.skipif(not find_spec("mujoco"), reason="MuJoCo is not installed")
def test_an_unstable_simulation_goes_on_from_where_it_was(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # MuJoCo logs there
    plant, ids = physics(DRY, 2), np.arange(2)
    plant.place(ids, np.array([[1.5, 0.5, 0.0], [3.5, 0.5, 1.0]]))
    plant._qvel[1, 0] = 1e7  # MuJoCo would reset it
    plant.drive(ids, np.full((2, 2), 5.0), np.ones((2, 2)), 0.05)
    assert plant.pose(ids)[0, 0] > 1.5
    assert plant.pose(ids)[1] == pytest.approx([3.5, 0.5, 1.0])
    assert (plant.speed(ids)[1] == 0).all()
