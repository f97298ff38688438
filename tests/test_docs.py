"""What protects readers of the documentation: links, snippets and commands work, and what there is is named."""

import importlib.util
import re
from ast import literal_eval
from collections import Counter
from collections.abc import Iterable
from itertools import dropwhile, takewhile
from pathlib import Path

import gymnasium as gym
import pytest
from pytest import approx

import sumo_env
from docs.pages import filled, page_of, templates
from sumo_env.config import COMMON, FIXED, WITHOUT_EFFECT
from sumo_env.contacts.crash import CrashRecord
from sumo_env.scenarios import NetworkTask
from sumo_env.tasks import TASKS
from tests.processes import ROOT, python_again
from tests.tasks import OF_HIGHWAY_ENV, every_task

PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
TEXTS = {page: page.read_text(encoding="utf-8") for page in PAGES}
names = [str(page.relative_to(ROOT)) for page in PAGES]
each_page = pytest.mark.parametrize("page", PAGES, ids=names)
SNIPPETS = [
    pytest.param(block, id=f"{page.relative_to(ROOT)}-{number}")
    for page in PAGES
    for number, block in enumerate(
        re.findall(r"^```python\n(.*?)^```", TEXTS[page], re.DOTALL | re.MULTILINE), 1
    )
]


def section(text: str, title: str) -> str:
    """What stands under a heading, subsections included."""
    found = re.search(rf"^(#+) {re.escape(title)}\n(.*?)(?=^\1 |\Z)", text, re.DOTALL | re.MULTILINE)
    assert found, f"no section {title!r}"
    return found[2]


def table(text: str) -> dict[str, list[str]]:
    """The rows of the first table of a text: first cell -> the other cells, backticks removed from the first."""
    rows = dropwhile(lambda line: not line.startswith("|"), text.splitlines())
    lines = list(takewhile(lambda line: line.startswith("|"), rows))[2:]
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
    return {first.strip("`"): others for first, *others in cells}


def page(name: str) -> str:
    """The text of a page of docs/."""
    return TEXTS[ROOT / "docs" / name]


# -- what is named exists ----------------------------------------------------------------------------------------------


@each_page
def test_ids_commands_and_files_exist(page: Path) -> None:
    text = TEXTS[page]
    assert set(re.findall(r"sumo/[a-z-]+-v\d", text)) <= {
        *sumo_env.IDS,
        *sumo_env.SUMO_TUPLE_IDS,
        sumo_env.SUMO_FAST_ID,
    }
    for file in re.findall(r"python ([\w/.-]+\.py)(?![^`\n]*` at commit )", text):  # what went is named so
        assert (ROOT / file).is_file(), file
    for module in re.findall(r"python -m ([\w.]+)(?![^`\n]*` at commit )", text):
        assert importlib.util.find_spec(module), module
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    for target in re.findall(r"(?:^    |`)make ([a-z-]+)", text, re.MULTILINE):
        assert re.search(rf"^{target}:", makefile, re.MULTILINE), f"make {target}"

    for path in re.findall(r" (tests/[\w/]+\.py)", text):  # what a command runs
        assert (ROOT / path).is_file(), path
    for path in re.findall(r"`((?:sumo_env|agents|experiments|networks|tests|docs)/[\w/.-]*)`", text):
        assert (ROOT / path).exists(), path


def anchors(text: str) -> set[str]:
    """GitHub's anchors of the headings of a page."""
    headings = re.findall(r"^#+ (.*)$", text, re.MULTILINE)
    return {re.sub(r"[^\w -]", "", heading.lower()).replace(" ", "-") for heading in headings}


@each_page
def test_links_resolve(page: Path) -> None:
    for link in re.findall(r"(?:\]\(|src=\")([^)\s\"]+)", TEXTS[page]):
        if link.startswith(("http://", "https://")):
            continue
        file, _, anchor = link.partition("#")
        target = (page.parent / file).resolve() if file else page
        assert target.exists(), link
        assert page.parent == ROOT or target.is_relative_to(ROOT / "docs"), f"{link} is not on the site"
        if anchor and target.name != "api.md":  # there, mkdocstrings makes the headings
            assert anchor in anchors(target.read_text(encoding="utf-8")), link


@pytest.mark.parametrize("block", SNIPPETS)
@pytest.mark.slow
def test_a_snippet_runs_when_it_is_copied_alone(block: str, tmp_path: Path) -> None:
    short = re.sub(r"learn\(\d+_\d+", "learn(150", block).replace("range(5000, 5100)", "range(5000, 5002)")
    short = short.replace('"duration": 120', '"duration": 20')
    (tmp_path / "snippet.py").write_text(short, encoding="utf-8")
    python_again("-c", "import snippet", cwd=tmp_path)


@pytest.mark.parametrize(("risk", "ending"), [("1.0", "crash"), ("0.0", "time")])
def test_the_readmes_drive_shows_what_risk_does(risk: str, ending: str, tmp_path: Path) -> None:
    script, *_ = re.findall(r"```python\n(.*?)```", section(TEXTS[ROOT / "README.md"], "Drive"), re.DOTALL)
    (tmp_path / "drive.py").write_text(script.replace('"risk": 1.0', f'"risk": {risk}'), encoding="utf-8")
    assert python_again("-c", "import drive", cwd=tmp_path).split() == [ending]
    assert (tmp_path / "drive.gif").is_file()


def test_the_steps_for_a_task_are_the_files_that_name_the_last_one() -> None:
    """Of those that highway-env has, as others take the first part of the steps alone; beside tests."""
    last = OF_HIGHWAY_ENV[-1]
    steps, _, _ = page("developers/extending.md").partition("## A key")
    rooms = "networks", "sumo_env", "agents", "experiments", "tests/golden"
    said = re.findall(rf"`((?:{'|'.join(rooms)})/[\w/.<>-]+)`", steps)
    word = re.compile(rf'"{last}"|\b{last}/|tasks\.{last}\b|import [\w, ]*\b{last}\b|(?<![.\w]){last}\(')
    files = (file for room in rooms for end in ("py", "json") for file in (ROOT / room).rglob(f"*.{end}"))
    found = {file for file in files if last == file.stem or word.search(file.read_text(encoding="utf-8"))}
    folder = ROOT / "networks" / last
    assert {ROOT / name.replace("<name>", last) for name in said} == found | {folder}
    assert len(list(folder.iterdir())) % 4 == 0


def lines_of(file: Path) -> int:
    return sum(bool(line.strip()) for line in file.read_text(encoding="utf-8").splitlines())


def ledger() -> dict[str, int]:
    """Lines that are not blank, by the features of the page: a module's row is the one that names it most exactly."""
    rows, owner = table(section(page("developers/ledger.md"), "By feature")), dict[str, str]()
    for feature, (modules, *_) in rows.items():
        for path in modules.replace("`", "").split():
            start, _, inner = path.rstrip("}").partition("{")
            owner |= {f"{start}{each}": feature for each in inner.split(",")}
    lines = dict.fromkeys(rows, 0)
    rooms, ends = ("networks", "sumo_env", "agents", "experiments"), ("py", "j2", "css")
    for file in (file for room in rooms for end in ends for file in (ROOT / room).rglob(f"*.{end}")):
        path = str(file.relative_to(ROOT))
        lines[owner[max(filter(path.startswith, owner), key=len)]] += lines_of(file)
    return lines


def is_about(said: str, lines: int) -> bool:
    return abs(lines - int(said.replace(",", ""))) <= max(25, 0.15 * lines)


def test_the_risk_of_every_task_is_on_its_page() -> None:
    said = table(section(page("traffic-and-risk.md"), "Risk"))
    rows = {task: row for tasks, row in said.items() for task in tasks.split(", ")}

    def every(rate: float, *how: float) -> str:
        words = " ({:g} m/s² for {:g} s)".format(*how) if how else ""
        return f"{1 / rate:.0f} s{words}" if rate else "-"

    for name, task in TASKS.items():
        rates = task.risk_rates
        brakes = every(rates.brake, rates.brake_decel, rates.brake_duration)
        surges = every(rates.surge, rates.surge_accel, rates.surge_duration)
        found = rows.get(name)
        assert found == [every(rates.cut_in), brakes, surges], (
            f"{name}: docs/templates/traffic-and-risk.md.j2"
        )


def test_every_module_and_every_folder_of_tests_is_named_with_about_its_lines() -> None:
    features = table(section(page("developers/ledger.md"), "By feature"))
    folders = table(section(page("developers/architecture.md"), "Tests that hold a room"))
    assert [name for name, n in ledger().items() if not is_about(features[name][1], n)] == []
    count = Counter[str]()
    for file in (ROOT / "tests").rglob("*.py"):
        count[str(file.parent.relative_to(ROOT / "tests"))] += lines_of(file)
    assert count.keys() == folders.keys()
    assert [name for name, n in count.items() if not is_about(folders[name][0], n)] == []


# -- what the code has is named ----------------------------------------------------------------------------------------


@every_task
def test_a_task_s_page_names_its_keys_its_levels_and_its_reward(task: str) -> None:
    own, common = page(f"environments/{task}.md"), page("environments/common.md")
    env = gym.make(f"sumo/{task}-v0")
    info = env.reset(seed=0)[1]
    env.close()
    named = set(re.findall(r"`(\w+)`", own + common))
    assert {*COMMON, *TASKS[task].defaults, *info, *info["rewards"]} - named == set()
    levels = [literal_eval(shown) for shown in re.findall(r"`(\{.*?\})`", own)]
    for config in TASKS[task].levels.values():  # so that they can be copied
        assert any(shown == approx(config, rel=1e-5) for shown in levels), config


@pytest.mark.parametrize(
    ("names", "keys"),
    [
        (["collisions.md"], CrashRecord.__dataclass_fields__),
        (["from-highway-env.md"], {*WITHOUT_EFFECT, *FIXED}),
        (["scenarios.md", "own-network.md"], NetworkTask.defaults),
    ],
)
def test_keys_that_users_meet_elsewhere_are_named(names: list[str], keys: Iterable[str]) -> None:
    text = "".join(map(page, [*names, "environments/common.md"]))
    assert set(keys) - set(re.findall(r"`(\w+)`", text)) == set()


each_template = pytest.mark.parametrize("template", templates(), ids=lambda path: path.name)


@each_template
def test_a_page_is_what_its_template_makes_of_the_results(template: Path) -> None:
    page = page_of(template)
    assert TEXTS[page] == filled(template), f"make pages writes {page.relative_to(ROOT)} again"


def test_each_page_that_says_so_has_a_template() -> None:
    made = [page for page in PAGES if TEXTS[page].startswith("<!-- Filled by")]
    assert sorted(made) == sorted(map(page_of, templates())) != []


@each_page
def test_all_lines_of_a_table_have_as_many_cells(page: Path) -> None:
    for rows in re.findall(r"(?:^\|.*\n)+", TEXTS[page], re.MULTILINE):
        assert len({line.count("|") for line in rows.splitlines()}) == 1, rows
