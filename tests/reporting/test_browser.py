"""A report's page in a real browser: what it asks for, computes, shows and exports; by mouse, keyboard and in print.

Screenshots of the factory's page, at two widths and in two themes, are left in out/screenshots.
"""

import json
import os
import re
import shutil

import numpy as np
import pytest

import stltool as stl
from stltool.automata import UNDECIDED
from stltool.reporting import render, report_data
from tests.conftest import FACTORY, ROOT, many, some
from tests.reporting.test_markup import (  # noqa: F401  # fixtures
    estimated,
    front,
    margins,
    monitored,
    relaxed,
    swept,
    varied,
    verified,
)
from tests.reporting.test_twin import random_edits, random_product

sync_api = pytest.importorskip("playwright.sync_api", reason="browser tests need playwright, which is absent")
CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
pytestmark = [
    pytest.mark.skipif(CHROMIUM is None, reason="browser tests need Chromium, which is absent"),
    pytest.mark.xdist_group("browser"),
]
SCREENSHOTS = ROOT / "out" / "screenshots"
DARK = "rgb(26, 26, 26)"  # captions of coloured cells, in floor.py
EVIL = "</script><img src=x onerror=alert(1)>"


@pytest.fixture(scope="module")
def browser():
    with sync_api.sync_playwright() as playwright:
        flags = ["--no-sandbox"] if os.geteuid() == 0 else []
        launched = playwright.chromium.launch(executable_path=CHROMIUM, args=flags)
        yield Browser(launched)
        launched.close()


class Browser:
    """Its tabs, one for all pages of a kind: a tab of its own costs a page three times what the page does."""

    def __init__(self, launched):
        self._launched, self._tabs = launched, {}

    def tab(self, **kind):
        key = frozenset(kind.items())
        if key not in self._tabs:
            self._tabs[key] = self._launched.new_context(**kind).new_page()
        return self._tabs[key]

    def close(self, tab):
        self._tabs = {key: other for key, other in self._tabs.items() if other is not tab}
        tab.context.close()


class Opened:
    """A page with all that it asked for and said; `kind` of tab, which no page opened later has if it is spoilt."""

    def __init__(self, browser, path, width=1280, scheme="light", motion="no-preference", spoilt=False, **kind):
        self._browser, self._spoilt = browser, spoilt
        self.page = browser.tab(**kind)
        self.page.set_viewport_size({"width": width, "height": 900})
        self.page.emulate_media(media="null", color_scheme=scheme, reduced_motion=motion)
        self.said, self.requests = [], []
        self._heard = {
            "console": lambda message: self.said.append(message.text),
            "pageerror": lambda error: self.said.append(str(error)),
            "request": lambda request: self.requests.append(request.url),
        }
        for event, hear in self._heard.items():
            self.page.on(event, hear)
        self.page.goto(path.as_uri())

    def __enter__(self):
        return self

    def __exit__(self, *error):
        for event, hear in self._heard.items():
            self.page.remove_listener(event, hear)
        if self._spoilt or error[0] is not None:
            self._browser.close(self.page)
        else:
            self.page.goto("about:blank")
        if error[0] is None:
            assert self.said == []
            assert all(url.startswith(("file:", "blob:")) for url in self.requests)
            assert sum(url.startswith("file:") for url in self.requests) == 1

    def js(self, code, argument=None):
        return self.page.evaluate(code, argument)

    def text(self, selector):
        return self.page.inner_text(selector)


@pytest.fixture(scope="module")
def factory(tmp_path_factory):
    """A learned policy's report on the small floor: product, policy, data, and the page's path."""
    task = stl.load_task(FACTORY / "patrolling.stl", params={"T": 4, "tau": 6})
    product = stl.build_product(stl.load_model(FACTORY / "floor-5x5.toml"), task)
    run = stl.learn(product, "cfer", episodes=150, seed=1)
    folder = tmp_path_factory.mktemp("factory")
    checks = [stl.check(product), stl.check(product, run.policy)]
    stl.report(checks, run, folder / "report.html", guarantees=[stl.guarantee(product, run.policy, run.counts)])
    data = json.loads((folder / "report.json").read_text())
    return product, run.policy, data, folder / "report.html"


@pytest.fixture
def opened(browser, factory):
    with Opened(browser, factory[3]) as page:
        yield page


@pytest.fixture(scope="module")
def rough():
    """A task on the floor whose probabilities are intervals."""
    task = stl.load_task(FACTORY / "patrolling.stl", params={"T": 2, "tau": 5})
    return stl.build_product(stl.load_model(FACTORY / "floor-5x5-uncertain.toml"), task)


def write(folder, data):
    path = folder / "page.html"
    path.write_text(render(json.loads(json.dumps(data))), encoding="utf-8")
    return path


def exported(page, folder):
    with page.page.expect_download() as waiting:
        page.page.click("#export")
    path = folder / "edited.npz"
    waiting.value.save_as(path)
    return path


def test_the_page_computes_what_the_checker_did(opened, factory):
    claim = factory[2]["explorer"]["claim"]
    assert opened.js("[explorer.P0, explorer.Pbest]") == pytest.approx(
        [claim["probability"], claim["optimum"]], abs=1e-12
    )
    assert opened.js("[explorer.M.N, explorer.M.checksum, explorer.agrees]") == [
        claim["nodes"],
        claim["checksum"],
        True,
    ]
    assert "agree to 10⁻¹²" in opened.text("#agrees")
    assert int(opened.js("document.documentElement.dataset.ready")) <= 2000


def test_a_page_that_disagrees_says_so(browser, factory, tmp_path):
    data = json.loads(json.dumps(factory[2]))
    data["explorer"]["claim"]["probability"] -= 1e-9
    with Opened(browser, write(tmp_path, data)) as page:
        assert "do not trust the explorer" in page.text("#agrees")


def test_edits_are_judged_exactly_and_exported(opened, factory, tmp_path):
    product = factory[0]
    edits = random_edits(product, np.random.default_rng(0), 20)
    before = opened.js("explorer.P()")
    opened.js("edits => { for (const [n, i] of edits) explorer.edit(n, i); explorer.draw(); }", edits)
    loaded = stl.load_policy(exported(opened, tmp_path), product)
    assert opened.js("explorer.P()") == pytest.approx(stl.check(product, loaded).probability, abs=1e-12)
    assert opened.text("#edited-p") == opened.js("explorer.full(explorer.P())")
    opened.page.click("#undo")
    assert opened.js("explorer.P()") == before  # bit for bit
    assert not opened.page.is_visible("#edited")


def test_an_edit_by_mouse_keeps_the_focus(opened):
    """Another action is tried, then used; P changes at once, and the focus stays on it."""
    opened.page.click("#here .choices button >> nth=1")
    assert opened.js("document.activeElement.closest('.choices') !== null")
    opened.page.click("#here .outcomes button.primary")
    assert opened.js("explorer.edits.size") == 1
    assert opened.js("document.activeElement.closest('tr.on') !== null")
    assert opened.text("#edited").startswith("1 edit")
    assert "edited" in opened.text("#here tr.on")


def test_the_reported_run_is_the_reports(opened, factory):
    """At every step chip, memory and P are Python's; the picture's ring is where the run is."""
    product, _, data, _ = factory
    automaton, q = product.automaton, product.automaton.initial
    values = opened.js("Array.from(explorer.V)")
    for t, s in enumerate(data["run"]["states"]):
        opened.js("t => explorer.go(t)", t)
        q = product.enter(s, q)
        assert opened.js("t => explorer.run().steps[t]", t)[:2] == [s, q]
        assert opened.text("#where") == f"step {t} of {product.horizon}"
        [x, y] = opened.js("s => [explorer.E.position.x[s] * 100 + 50, explorer.E.position.y[s] * 100 + 45]", s)
        ring = "(c => [+c.getAttribute('cx'), +c.getAttribute('cy')])(document.querySelector('.robot'))"
        assert opened.js(ring) == [x, y]
        levels = [track.levels[track.level_of[q]].phrase for track in automaton.tracks(_named(product))]
        shown = opened.text("#here .memory").removeprefix("Remembered now: ").split("; ")
        assert set(shown) == {level for level in levels if level != "nothing pending"} or set(levels) == {
            "nothing pending"
        }
        if automaton.verdicts(t)[q] == UNDECIDED:
            n = opened.js("([t, s, q]) => explorer.M.node(t, s, q)", [t, s, int(q)])
            assert f"P {opened.js('p => explorer.brief(p)', values[n])}" in opened.text("#chip")
        else:
            assert ("satisfied" if data["run"]["satisfied"] else "violated") in opened.text("#chip")


def _named(product):
    from stltool.logic.printer import with_names

    return with_names(product.definitions)


def test_values_at_every_node_are_the_checkers(opened, factory):
    """The value of starting in a node: P of the model with that state first, its automaton in that state."""
    product, policy, _, _ = factory
    n = opened.js("explorer.M.N - 1")
    t, s, q = opened.js("n => [explorer.M.step[n], explorer.M.state[n], explorer.M.memory[n]]", n)
    i = int(policy.at(t, s, q)[0])
    model = product.model
    c = model.choice_start[s] + i
    entry = slice(model.row_start[c], model.row_start[c + 1])
    after = product.automaton.delta[product.letter[model.target[entry]], q]
    verdict = product.automaton.verdicts(t + 1)[after]
    assert (verdict != UNDECIDED).all()  # the last layer
    assert opened.js("n => explorer.V[n]", n) == pytest.approx(
        float(model.probability[entry] @ (verdict == 1)), abs=1e-15
    )


def test_the_most_probable_violation_is_the_checkers(opened, factory):
    data = factory[2]
    worst = data["why"]["runs"][0]
    opened.page.select_option("#run", "bad")
    states = opened.js("explorer.run().steps.map(step => step[0])")
    found = opened.js("explorer.likeliest(explorer.M, explorer.policy, -1).p")
    assert found == pytest.approx(worst["probability"], rel=1e-9)
    assert len(states) == len(worst["state_indices"])
    if data["why"]["runs"][1]["probability"] < 0.999 * worst["probability"]:
        assert states == worst["state_indices"]
    opened.page.click("#last")
    assert "violated" in opened.text("#chip")


@pytest.mark.soak(only=True)
def test_every_memory_that_can_be_is_reached_by_the_sliders(opened):
    """Each part's slider to each of its levels, at three steps: the memory shown can be, and has that level."""
    for t in (1, 4, 6):
        opened.js("t => explorer.go(t)", t)
        for part in range(opened.js("explorer.tracks.length")):
            slider = opened.page.locator(f"#part{part}")
            for k in range(int(slider.get_attribute("max")) + 1):
                if not slider.is_disabled():
                    slider.fill(str(k))
                assert opened.js("explorer.alive(explorer.view.t).includes(explorer.view.m)")
                phrase = opened.js("i => explorer.tracks[i].phrases[explorer.tracks[i].of[explorer.view.m]]", part)
                assert opened.text(f"output[for=part{part}]") == phrase == slider.get_attribute("aria-valuetext")
    reached = opened.js("""() => {
        const seen = new Set();
        for (const q of explorer.alive(5)) { explorer.go(5, q); seen.add(explorer.view.m); }
        return seen.size === explorer.alive(5).length;
    }""")
    assert reached


@pytest.mark.soak(only=True)
def test_keys(opened):
    press = opened.page.keyboard.press
    opened.page.focus("#on")
    press("Home")
    assert opened.js("explorer.view.t") == 0
    press("ArrowRight")
    press("ArrowRight")
    press("ArrowLeft")
    assert opened.js("explorer.view.t") == 1
    press("End")
    last = opened.js("explorer.run().steps.length - 1")
    assert opened.js("explorer.view.t") == last
    press("n")
    assert opened.js("explorer.run().name").startswith("sample")
    opened.page.focus("#back")
    before = opened.js("explorer.run().name")
    press("Home")
    opened.page.focus("#on")
    press(" ")  # presses that button, and does not play
    assert opened.js("[explorer.view.t, explorer.run().name]") == [1, before]
    assert "Play" in opened.text("#play")
    opened.page.locator("svg .cell[tabindex='0']").focus()
    first = opened.js("document.activeElement.getAttribute('aria-label')")
    press("ArrowDown")
    assert opened.js("document.activeElement.getAttribute('aria-label')") != first
    assert opened.js("explorer.view.t") == 1
    press("b")
    assert opened.js("explorer.view.s") is None


@pytest.mark.soak(only=True)
def test_a_run_plays_and_pauses(browser, factory):
    with Opened(browser, factory[3], spoilt=True) as page:
        page.page.clock.install()
        page.page.reload()
        page.requests.pop()
        page.js("explorer.go(0)")
        page.page.click("#play")
        page.page.clock.run_for(1500)
        assert page.js("explorer.view.t") == 2
        page.page.click("#play")
        page.page.clock.run_for(1500)
        assert page.js("explorer.view.t") == 2
        page.page.click("#play")
        page.page.clock.run_for(20_000)
        assert page.js("explorer.view.t === explorer.run().steps.length - 1")
        assert "Play" in page.text("#play")


@pytest.mark.soak(only=True)
def test_a_run_branches_where_one_chooses(opened):
    opened.js("explorer.go(1)")
    goal = opened.page.inner_text("#here .outcomes .row button >> nth=-1").split(" ·")[0].split(" ")[0]
    opened.page.click("#here .outcomes .row button >> nth=-1")
    assert opened.js("explorer.run().name") == "your branch"
    assert opened.js("explorer.E.states[explorer.run().steps[2][0]]") == goal
    assert opened.js("explorer.view.t") == 2
    kept = opened.js("explorer.run().steps.slice(0, 2).map(step => step[0])")
    opened.page.select_option("#run", "report")
    assert opened.js("explorer.run().steps.slice(0, 2).map(step => step[0])") == kept


def test_the_picture_is_a_table_too(opened):
    opened.page.click("#as-table summary")
    opened.page.wait_for_selector("#map-table tbody tr")
    rows = opened.page.locator("#map-table tbody tr")
    assert rows.count() > 3
    assert opened.page.locator("#map-table th[scope=col]").count() == 7


@pytest.fixture
def plain(patrolling):
    """A check without a training, of the best policy."""
    return report_data([stl.check(patrolling)])


@pytest.fixture
def graph():
    """States that are not cells, and a task of more than two parts."""
    product = random_product(np.random.default_rng(1))
    return report_data([stl.check(product), stl.check(product, maximize=False)])


@pytest.fixture
def intervals(rough):
    return report_data([stl.robust_check(rough)])


@pytest.fixture
def refused(rough):
    """A report without an explorer."""
    return report_data([stl.robust_check(rough, keep_policy=False)])


@pytest.fixture
def decided(floor5):
    return report_data([stl.check(stl.build_product(floor5, stl.parse("F[0,3] !A")))])


@pytest.fixture
def learned(factory):
    return factory[2]


PAGES = ["learned", "plain", "graph", "intervals", "refused", "decided",
         "swept", "verified", "front", "monitored", "estimated", "margins", "varied", "relaxed"]  # fmt: skip


@pytest.mark.soak
@pytest.mark.parametrize("kind", ["learned", *some(PAGES[1:])])
def test_every_page_fits_a_phone_and_is_open_to_screen_readers_in_both_themes(browser, kind, request, tmp_path):
    axe = pytest.importorskip("axe_playwright_python.sync_playwright", reason="axe-core is absent").Axe()
    with Opened(browser, write(tmp_path, request.getfixturevalue(kind)), width=390, bypass_csp=True) as page:
        assert page.js("document.documentElement.scrollWidth") == 390
        for width, scheme in ((390, "light"), (1280, "dark")):
            page.page.set_viewport_size({"width": width, "height": 900})
            page.page.emulate_media(color_scheme=scheme)
            found = axe.run(page.page)
            assert [violation["id"] for violation in found.response["violations"]] == [], (width, scheme)


def test_every_kind_of_page_is_among_them():
    templates = {path.stem for path in (ROOT / "stltool" / "reporting" / "templates").glob("*.html")}
    assert templates - {"page", "macros", "explorer"} == {
        "report", "verify", "sweep", "front", "monitor", "estimate", "answer"
    }  # fmt: skip


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_ink_can_be_read_on_every_colour_of_the_ramp(browser, factory, scheme):
    """Contrast of at least 4.5 at twenty points; axe does not look at pictures."""
    with Opened(browser, factory[3], scheme=scheme) as page:
        ratios = page.js("""() => {
            const probe = document.createElement("canvas").getContext("2d", { willReadFrequently: true });
            const light = (colour) => {
                probe.fillStyle = colour;
                probe.fillRect(0, 0, 1, 1);
                const part = [...probe.getImageData(0, 0, 1, 1).data].slice(0, 3).map((x) => x / 255)
                    .map((x) => (x <= 0.04045 ? x / 12.92 : ((x + 0.055) / 1.055) ** 2.4));
                return 0.2126 * part[0] + 0.7152 * part[1] + 0.0722 * part[2];
            };
            const cell = document.querySelector("svg .cell"), ink = document.querySelector(".ink");
            const bg = cell.querySelector(".bg"), text = ink.querySelector(".value"), ratios = [];
            bg.style.transition = "none";
            for (let i = 0; i < 20; i++) {
                const k = i / 19;
                const kind = ["cell", k < 0.5 ? "l" : "h", k > 0.6 ? "d1" : "", k > 0.75 ? "d2" : ""].join(" ");
                cell.setAttribute("class", kind);
                ink.setAttribute("class", kind + " ink");
                cell.style.setProperty("--m", String(Math.round((k < 0.5 ? k : k - 0.5) * 200)));
                const both = [bg, text].map((shape) => light(getComputedStyle(shape).fill));
                const [a, b] = both.sort((x, y) => y - x);
                ratios.push((a + 0.05) / (b + 0.05));
            }
            return ratios;
        }""")
        assert min(ratios) >= 4.5


@pytest.mark.parametrize(("scheme", "plain"), [("light", "rgb(26, 29, 33)"), ("dark", "rgb(232, 234, 236)")])
def test_captions_of_coloured_cells_are_dark_on_every_page(browser, factory, scheme, plain):
    """Those of white cells, which are dark on a dark page, are in its ink."""
    with Opened(browser, factory[3], scheme=scheme) as page:
        colours = dict(
            page.js(
                "[...document.querySelectorAll('.pictures .caption text')]"
                ".map(t => [t.textContent, getComputedStyle(t).fill])"
            )
        )
        assert colours == {"A": DARK, "B": DARK, "C": DARK, "start": plain}


@pytest.mark.parametrize("width", [390, 1280])
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_pages_fit_and_are_kept_as_pictures(browser, factory, width, scheme):
    SCREENSHOTS.mkdir(parents=True, exist_ok=True)
    with Opened(browser, factory[3], width=width, scheme=scheme) as page:
        assert page.js("document.documentElement.scrollWidth") == width
        high, letter = page.js("""(({ clientHeight }, { fontSize }) => [clientHeight, parseFloat(fontSize)])(
            document.querySelector(".verdict .p"), getComputedStyle(document.querySelector(".verdict .p")))""")
        assert high < 2 * letter  # a number on one line
        page.page.screenshot(path=SCREENSHOTS / f"factory-{width}-{scheme}.png", full_page=True)


def test_on_paper_it_is_light_and_without_controls(browser, factory):
    with Opened(browser, factory[3], width=688, scheme="dark") as page:  # A4 between its margins
        page.page.emulate_media(media="print", color_scheme="dark")
        assert page.js("getComputedStyle(document.body).backgroundColor") == "rgb(255, 255, 255)"
        for control in ("#theme", ".bar", "#sliders", ".outcomes"):
            assert not page.page.is_visible(control)
        assert page.js("document.documentElement.scrollWidth") == 688


def test_without_motion_nothing_moves(browser, factory):
    with Opened(browser, factory[3], motion="reduce") as page:
        assert page.js("getComputedStyle(document.querySelector('.cell .bg')).transitionDuration") == "0s"


def test_the_theme_can_be_chosen(opened):
    paper = "getComputedStyle(document.body).backgroundColor"
    light = opened.js(paper)
    opened.page.click("#theme")
    assert opened.js(paper) == light
    opened.page.click("#theme")
    assert opened.js(paper) != light


def test_names_stay_texts(browser, tmp_path):
    """A model whose every name is markup: the page shows it, and nothing of it is an element."""
    rows = np.full((2, 3, 3), 1 / 3)
    names = [f"{EVIL}{i}" for i in range(3)]
    labels = {f"{EVIL}l": [True, False, False], "a": [False, True, False]}
    model = stl.MDP.from_arrays(rows, {}, labels=labels, state_names=names, action_names=names[:2], name=EVIL)
    product = stl.build_product(model, stl.parse("F[0,4] (a & F[1,2] a)"))
    stl.report(stl.check(product), None, tmp_path / "page.html")
    with Opened(browser, tmp_path / "page.html") as page:
        assert page.js("document.querySelectorAll('img').length") == 0
        assert names[1] in page.text("#line") + page.text("#here")
        page.page.click("#as-table summary")
        page.page.wait_for_selector("#map-table tbody tr")
        assert names[0] in page.text("#map-table")


@pytest.mark.parametrize("seed", range(many(5)))
def test_random_models_are_explored_as_graphs(browser, tmp_path, seed):
    rng = np.random.default_rng(seed)
    product = random_product(rng)
    best = stl.check(product)
    data = report_data([best])
    with Opened(browser, write(tmp_path, data)) as page:
        assert page.js("explorer.agrees")
        edits = random_edits(product, rng, 6)
        if not edits:
            return
        page.js("edits => { for (const [n, i] of edits) explorer.edit(n, i); explorer.draw(); }", edits)
        if page.js("explorer.edits.size"):
            loaded = stl.load_policy(exported(page, tmp_path), product)
            assert page.js("explorer.P()") == pytest.approx(stl.check(product, loaded).probability, abs=1e-12)
        page.page.select_option("#run", "new")
        assert re.search(r"step 0 of \d+", page.text("#where"))


@pytest.mark.soak(only=True)
def test_two_robots_are_explored_on_their_floors(browser, tmp_path):
    """The picture is one robot's floor, the other one stays where the run has it; every cell is a joint state."""
    task = stl.load_task(ROOT / "examples" / "team" / "handover.stl")
    model = stl.load_model(task.model)
    product = stl.build_product(model, task)
    stl.report(stl.check(product), None, tmp_path / "page.html")
    floor = model.members["r1"]
    n = floor.n_states
    with Opened(browser, tmp_path / "page.html") as page:
        assert page.js("explorer.agrees")
        for body, (name, stride) in enumerate((("r1", n), ("r2", 1))):
            page.page.select_option("#body", str(body))
            assert f"The floor of {name}" in page.text("#floor")
            here = page.js("explorer.run().steps[explorer.view.t][0]")
            states = page.js("n => Array.from({ length: n }, (_, u) => explorer.stateAt(u))", n)
            assert states == [here + (u - here // stride % n) * stride for u in range(n)]
            told = page.js(
                "[...document.querySelectorAll('#floor g.cell[role=button]')].map(g => g.getAttribute('aria-label'))"
            )
            assert len(told) == n
            for s, text in zip(states, told, strict=True):
                assert text.startswith(f"state {model.state_name(s)}")
            captions = page.js("[...document.querySelectorAll('#floor .ink text:first-child')].map(t => t.textContent)")
            assert [set(text.split()) for text in captions] == [
                {label for label, where in floor.labels.items() if where[u]} for u in range(n)
            ]
            open_cells = page.js(
                "[...document.querySelectorAll('#floor g.cell[role=button]')].map((g, u) => [g, u])"
                ".filter(([g]) => g.getAttribute('aria-disabled') === 'false').map(([, u]) => u)"
            )
            cell = next(u for u in open_cells if states[u] != here)
            click = "dispatchEvent(new MouseEvent('click'))"
            page.js(f"u => document.querySelectorAll('#floor g.cell[role=button]')[u].{click}", cell)
            assert page.js("explorer.view.s") == states[cell]
            assert model.state_name(states[cell]) in page.text("#here h3")
            page.js("explorer.go(explorer.view.t)")
        arrows = page.js("explorer.E.position.bodies.map(body => body.actions)")
        for a, name in enumerate(model.action_names):
            assert name == "+".join(f"r{i}.{own[a]}" for i, own in enumerate(arrows, start=1))
        # what is remembered takes a line of words: steps are narrow all the same
        widths = page.js("[...document.querySelectorAll('.line td')].map(td => td.offsetWidth / td.colSpan)")
        assert max(widths) < 160
        where = page.js("""[document.querySelector(".line td.now"), document.querySelector(".spark .cursor")]
            .map(part => part.getBoundingClientRect()).map(box => box.x + box.width / 2)""")
        assert where[0] == pytest.approx(where[1], abs=1.5)
        SCREENSHOTS.mkdir(parents=True, exist_ok=True)
        page.page.locator("#explorer").screenshot(path=SCREENSHOTS / "team.png")


def test_mixtures_are_shown_and_exported(browser, patrolling, tmp_path):
    weights = np.random.default_rng(0).dirichlet(np.full(9, 0.3), size=patrolling.shape)
    policy = stl.Policy(patrolling, weights)
    with Opened(browser, write(tmp_path, report_data([stl.check(patrolling), stl.check(patrolling, policy)]))) as page:
        assert page.js("explorer.agrees")
        assert "policy, " in page.text("#here")
        assert "%" in page.text("#here .choices")
        n = page.js("explorer.M.node(0, ...explorer.run().steps[0])")
        page.js("n => { explorer.edit(n, 3); explorer.draw(); }", n)
        loaded = stl.load_policy(exported(page, tmp_path), patrolling)
        assert page.js("explorer.P()") == pytest.approx(stl.check(patrolling, loaded).probability, abs=1e-12)


def test_a_policy_that_remembers_more_says_why_it_is_not_exported(browser, patrolling, flagged, tmp_path):
    policy = stl.Policy(flagged, stl.check(flagged).policy.table)
    data = report_data([stl.check(patrolling), stl.check(patrolling, policy)])
    with Opened(browser, write(tmp_path, data)) as page:
        assert page.js("explorer.agrees")
        page.js("explorer.edit(0, 1); explorer.draw()")
        assert "cannot be exported" in page.text("#edited")
        assert not page.page.is_visible("#export")


@pytest.mark.parametrize("nature", ["against", "with"])
def test_intervals_are_explored_with_natures_picks(browser, rough, tmp_path, nature):
    """P of the page is the robust check's, also after an edit; the picks of an action sum to 1, in their intervals."""
    policy = stl.robust_check(rough).policy
    checks = [stl.robust_check(rough, nature=nature), stl.robust_check(rough, policy, nature=nature)]
    with Opened(browser, write(tmp_path, report_data(checks))) as page:
        assert page.js("explorer.agrees")
        assert f"for the {'least' if nature == 'against' else 'greatest'} P" in page.text("#agrees")
        assert re.search(r"\d % of \d+ % … \d+ %", page.text("#here .outcomes"))
        picked = page.js("""() => {
            const n = explorer.M.node(0, ...explorer.run().steps[0]);
            return outcomes(explorer.M, n, 1).map((o) => [o.p, ...o.range]);
        }""")
        assert sum(p for p, _, _ in picked) == pytest.approx(1, abs=1e-12)
        assert all(lower - 1e-12 <= p <= upper + 1e-12 for p, lower, upper in picked)
        page.js("n => { explorer.edit(0, 1); explorer.draw(); }")
        judged = stl.robust_check(rough, stl.load_policy(exported(page, tmp_path), rough), nature=nature)
        assert page.js("explorer.P()") == pytest.approx(judged.probability, abs=1e-12)
        page.page.select_option("#run", "bad")
        page.page.click("#last")
        assert "violated" in page.text("#chip")


@pytest.mark.soak(only=True)
def test_of_many_situations_those_of_the_policy_are_shown(browser, patrolling, tmp_path, monkeypatch):
    """The page says so; an action that leads elsewhere has no P, and cannot be put into the policy."""
    monkeypatch.setattr("stltool.checking.situations.reachable", lambda product: None)
    with Opened(browser, write(tmp_path, report_data([stl.check(patrolling)]))) as page:
        assert page.js("explorer.agrees")
        assert "All situations would be too many for a page" in page.text("#agrees")
        for t in range(4):
            page.js("t => explorer.go(t)", t)
            assert page.page.locator("#here tr.on").count() == 1
        page.js("explorer.go(0)")
        rows = "[...document.querySelectorAll('#here .choices tbody tr')]"
        row = page.js(f"{rows}.findIndex((row) => /not defined/.test(row.textContent))")
        page.page.click(f"#here .choices button >> nth={row}")
        assert "is not in this page" in page.text("#here .outcomes")
        assert page.page.locator("#here .outcomes button.primary").count() == 0
        for kind in ("new", "likely", "bad"):
            page.page.select_option("#run", kind)
            page.page.click("#last")
            assert re.search("satisfied|violated", page.text("#chip"))
        page.page.click("#as-table summary")
        page.page.wait_for_selector("#map-table tbody tr")


def test_a_report_without_an_explorer_says_why(browser, tmp_path):
    task = stl.load_task(FACTORY / "patrolling.stl", params={"T": 2, "tau": 5})
    product = stl.build_product(stl.load_model(FACTORY / "floor-5x5-p.toml"), task)
    with Opened(browser, write(tmp_path, report_data([stl.robust_check(product)]))) as page:
        assert "There is no explorer in this report: nature picks the model's parameters" in page.text("main")
        assert page.js("document.querySelectorAll('#automaton svg, #automaton .strip').length") > 0


def test_a_task_that_is_decided_at_once_has_a_page(browser, floor5, tmp_path):
    data = report_data([stl.check(stl.build_product(floor5, stl.parse("F[0,3] !A")))])
    with Opened(browser, write(tmp_path, data)) as page:
        assert page.js("[explorer.M.N, explorer.agrees]") == [0, True]
        assert "satisfied" in page.text("#chip")
        page.page.select_option("#run", "bad")
        assert page.text("#where") == "no run violates the task"


@pytest.mark.soak(only=True)
def test_the_large_factorys_page_is_small_and_quick(browser, tmp_path):
    task = stl.load_task(FACTORY / "patrolling.stl", params={"T": 15, "tau": 15})
    product = stl.build_product(stl.load_model(FACTORY / "floor-10x10.toml"), task)
    path = write(tmp_path, report_data([stl.check(product)]))
    assert path.stat().st_size <= 5_000_000
    with Opened(browser, path) as page:
        assert page.js("explorer.agrees")
        assert int(page.js("document.documentElement.dataset.ready")) <= 2000
