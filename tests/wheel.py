"""A plain `pip install` of the built wheel does what README shows: `python tests/wheel.py`, some minutes.

The wheel goes, without extras, into a fresh environment in a temporary folder. From another folder, which has a copy of
examples/, every command of README's table is run there as it stands, its placeholders filled in, with each of its
programs; what needs an extra says so; and docs/from-assert.md is gone through. A row that names something new fails
until it is told here what to fill in.
"""

from __future__ import annotations

import email
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path

from readme_renderer import markdown

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))
MOST_MEGABYTES = 600
FACTORY = "examples/factory/"
# the text of a row → what is filled in, longest first; later rows use what earlier ones write
FILLED = {
    "pareto TASK --tasks A,B": f"pareto {FACTORY}tradeoff.stl --tasks charging,patrolling --plot front.svg",
    "--nature against": f"--model {FACTORY}floor-5x5-uncertain.toml --nature against",
    '--require "B>=0.9" --budget "cost<=12"': '--require "patrolling>=0.5" --budget "C<=3"',
    "tradeoff TASK": f"tradeoff {FACTORY}tradeoff.stl",
    "--objective A": "--objective charging",
    "monitor TASK|FORMULA TRACE": 'monitor "F[0,5] battery > -1" examples/monitor/shift.csv --plot log.png',
    "explain TASK|FORMULA": 'explain "G[0,9] (a -> F[0,5] b)"',
    "--certificate FILE": "--certificate best.jsonl.gz",
    "--save-policy FILE": "--save-policy best.policy",
    "--report FOLDER": "--report out/checked",
    "certify FILE [TASK]": f"certify best.jsonl.gz {FACTORY}patrolling.stl",
    "--vary p=0.5:1": "--vary success=0.5:1",
    "explain TASK --policy FILE": f"explain {FACTORY}patrolling.stl --policy out/patrolling/policy.npz",
    "play TASK --policy FILE": f'play {FACTORY}patrolling.stl --policy out/patrolling/policy.npz --moves ". *"',
    "--model MODEL": f"--model {FACTORY}floor-5x5.toml",
    "--policy FILE": "--policy out/patrolling/policy.npz",
    "--out FILE": "--out learned.npz --checkpoint run.npz --history run.csv",
    "sweep FILE": "sweep examples/paper/small.toml --workers 2",
    "verify FILE...": f"verify {FACTORY}gate.stl --junit verify.xml --certificates proofs",
    "lint FILE...": f"lint {FACTORY}patrolling.stl",
    "convert IN OUT": f"convert {FACTORY}floor-5x5.toml floor.umb",
    "fmt FILE...": f"fmt {FACTORY}patrolling.stl {FACTORY}charging.stl",
    "REPORT.json": "out/patrolling/report.json",
    "new NAME --kind grid": "new shift --kind grid",
    "new NAME --example factory": "new copied --example factory",
    "diff A.json B.json": "diff out/patrolling/report.json out/patrolling/report.json",
    "TASK": f"{FACTORY}patrolling.stl",
}
# the policy function that README's table names
AGENT = "def act(situation):\n    return situation.actions[situation.step % len(situation.actions)]\n"
# what needs an extra, and its package
EXTRAS = {
    f"learn {FACTORY}patrolling.stl --out l.npz --tensorboard events": "tensorboard",
    "check examples/frozenlake/crossing.stl": "gymnasium",
    f"explain {FACTORY}patrolling.stl --policy out/patrolling/policy.npz": "trees",
    'monitor "F[0,5] x > 0" trace.parquet': "parquet",
    "convert robot.prism robot.umb": "storm",
    "sweep examples/paper/small.toml --out none --cluster tcp://localhost:1": "cluster",
}
UNFILLED = re.compile(r"\b[A-Z]{4,}\b|\bFILE\b|\.\.\.|\|")


def commands(readme: str) -> list[str]:
    """The commands of README's table, those that its descriptions name included, filled in."""
    table = re.search(r"## The command line\n\n```\n(.*?)```", readme, flags=re.DOTALL)
    assert table, "README has no table of commands"
    found = []
    for row in table[1].splitlines():
        command, _, rest = row.partition("  ")
        found += [command] * command.startswith("stltool ")
        found += re.findall(r"stltool \w+(?: \[?[A-Z.]+\]?)*", rest)
    for i, command in enumerate(found):
        for text, value in FILLED.items():
            command = re.sub(re.escape(text) + r"(?![\w.|])", lambda _, value=value: value, command)
        assert not UNFILLED.search(command), f"what is to be filled in here? {command}"
        found[i] = command
    return found


def main() -> None:
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    with tempfile.TemporaryDirectory() as temporary:
        work = Path(temporary)
        run = [sys.executable, "-m", "build", "--wheel", "--outdir", work / "dist", ROOT]
        subprocess.run(run, check=True, stdout=subprocess.DEVNULL)
        (wheel,) = (work / "dist").glob("*.whl")
        description = shown_on_an_index(wheel)
        print(f"wheel: README as a package index shows it has {len(description)} characters of HTML")
        subprocess.run([sys.executable, "-m", "venv", work / "fresh"], check=True)
        scripts = work / "fresh" / ("Scripts" if sys.platform == "win32" else "bin")
        python = scripts / "python"
        pip = [python, "-m", "pip", "--disable-pip-version-check", "--quiet"]
        before = megabytes(work / "fresh")
        subprocess.run([*pip, "install", wheel], check=True)
        size = megabytes(work / "fresh") - before
        print(f"wheel: {size:.0f} MB installed")
        assert size <= MOST_MEGABYTES, f"a plain install takes {size:.0f} MB, over {MOST_MEGABYTES}"
        folder = work / "elsewhere"
        shutil.copytree(ROOT / "examples", folder / "examples")
        (folder / "trace.parquet").touch()
        (folder / "robot.prism").touch()
        (folder / "my_agent.py").write_text(AGENT)

        used = set()
        for command in commands(readme):
            if command.removeprefix("stltool ") not in EXTRAS:
                call(scripts, folder, command)
            used.add(command.split()[1])
        code = "from stltool.cli import app; print(*(c.callback.__name__ for c in app.registered_commands))"
        listed = subprocess.run([python, "-c", code], cwd=folder, check=True, capture_output=True, text=True)
        assert used == set(listed.stdout.split()), "README's table and the commands differ"
        for command, extra in EXTRAS.items():
            call(scripts, folder, f"stltool {command}", code=2, says=f"pip install 'stltool[{extra}]'")
        for code in [*re.findall(r"```python\n(.*?)```", readme, flags=re.DOTALL), "import stltool.testing"]:
            subprocess.run([python, "-c", code], cwd=folder, check=True, stdout=subprocess.DEVNULL)
        follow_the_guide(python, work / "guide")
    print(f"wheel: {len(used)} commands of README and its programs work from another folder, without extras")


def follow_the_guide(python: Path, folder: Path) -> None:
    """docs/from-assert.md, as somebody goes through it who has installed stltool and pytest."""
    from tests.guide import steps

    subprocess.run([python, "-m", "pip", "--disable-pip-version-check", "--quiet", "install", "pytest"], check=True)
    folder.mkdir()
    for name, content, options, shown in steps():
        if name:
            (folder / name).write_text(content, encoding="utf-8")
            continue
        command = [python, "-m", "pytest", *shlex.split(options)]
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
        missing = [line for line in shown.splitlines() if line not in done.stdout]
        assert not missing, f"the guide shows {missing}, but pytest printed\n{done.stdout}{done.stderr}"
        print(f"wheel: pytest{options}, as the guide shows it")


def shown_on_an_index(wheel: Path) -> str:
    """README as an index renders it, which has no other file: nothing in it may lead to one."""
    with zipfile.ZipFile(wheel) as archive:
        name = next(one for one in archive.namelist() if one.endswith(".dist-info/METADATA"))
        text = email.message_from_bytes(archive.read(name)).get_payload(decode=True).decode("utf-8")
    html = markdown.render(text)
    assert html, "README cannot be rendered"
    led = re.findall(r'(?:href|src)="([^"]*)"', html)
    nowhere = [one for one in led if not one.startswith(("https://", "http://", "#"))]
    assert led, "README has no links left"
    assert not nowhere, f"README on a package index leads to files that are not there: {nowhere}"
    return html


def call(scripts: Path, folder: Path, command: str, code: int = 0, says: str = "") -> None:
    program, *arguments = shlex.split(command)
    done = subprocess.run([scripts / program, *arguments], cwd=folder, capture_output=True, text=True)
    if done.returncode != code or says not in done.stderr:
        raise SystemExit(f"wheel: exit code {done.returncode} of {command}\n{done.stdout}{done.stderr}")
    print(f"wheel: {command}")


def megabytes(folder: Path) -> float:
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file()) / 2**20


if __name__ == "__main__":
    main()
