"""What protects readers of the documentation: links, snippets, commands and named things work, and tables are true."""

from __future__ import annotations

import importlib.util
import re
import subprocess
import sys
from ast import literal_eval
from dataclasses import asdict
from pathlib import Path

import gymnasium as gym
import pytest

import sumo_env
from experiments.validation.checks import MARGINS
from sumo_env.config import COMMON, FILE_KEYS, FIXED, LEFT_OUT
from sumo_env.contacts.crash import CrashRecord
from sumo_env.tasks import TASKS
from sumo_env.tasks.network import NetworkTask
from sumo_env.traffic.drivers import RiskRanges
from tests.pages import PAGES, ROOT, TEXTS, section, table

names = [str(page.relative_to(ROOT)) for page in PAGES]
each_page = pytest.mark.parametrize("page", PAGES, ids=names)
SNIPPETS = [
    pytest.param(block, id=f"{page.relative_to(ROOT)}-{number}")
    for page in PAGES
    for number, block in enumerate(
        re.findall(r"^```python\n(.*?)^```", TEXTS[page], re.DOTALL | re.MULTILINE), 1
    )
]


def page(name: str) -> str:
    """The text of a page of docs/."""
    return TEXTS[ROOT / "docs" / name]


def keys(rows: dict[str, list[str]]) -> set[str]:
    """The names in the first column of a table."""
    return {name.strip("` ") for cell in rows for name in cell.split(",")}


# -- what is named exists ----------------------------------------------------------------------------------------------


@each_page
def test_ids_exist(page: Path) -> None:
    assert set(re.findall(r"sumo/[a-z-]+-v\d", TEXTS[page])) <= set(sumo_env.IDS)


@each_page
def test_commands_exist(page: Path) -> None:
    text = TEXTS[page]
    for file in re.findall(r"python ([\w/.-]+\.py)", text):
        assert (ROOT / file).is_file(), file
    for module in re.findall(r"python -m ([\w.]+)", text):
        assert importlib.util.find_spec(module), module
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    for target in re.findall(r"(?:^    |`)make ([a-z-]+)", text, re.MULTILINE):
        assert re.search(rf"^{target}:", makefile, re.MULTILINE), f"make {target}"


@each_page
def test_files_in_backticks_exist(page: Path) -> None:
    for path in re.findall(r"`((?:sumo_env|agents|experiments|networks|tests|docs)/[\w/.-]*)`", TEXTS[page]):
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
        if anchor and target.name != "api.md":  # there, mkdocstrings makes the headings
            assert anchor in anchors(target.read_text(encoding="utf-8")), link


@pytest.mark.parametrize("block", SNIPPETS)
@pytest.mark.slow
def test_a_snippet_runs_when_it_is_copied_alone(block: str, tmp_path: Path) -> None:
    (tmp_path / "snippet.py").write_text(block.replace("10_000", "150"), encoding="utf-8")
    command = [sys.executable, "-c", f"import sys; sys.path.insert(0, {str(ROOT)!r}); import snippet"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-2000:]


# -- tables say what the code does -------------------------------------------------------------------------------------


@pytest.mark.parametrize("task", TASKS)
def test_every_key_of_a_task_is_listed(task: str) -> None:
    own = table(section(page(f"environments/{task}.md"), "Keys of its own"))
    common = table(section(page("environments/common.md"), "Common keys of `config`"))
    assert {*COMMON, *TASKS[task].defaults} <= keys(own) | keys(common)
    for names, cells in own.items():
        defaults = [TASKS[task].defaults[name.strip("` ")] for name in names.split(",")]
        assert [literal_eval(value) for value in re.findall(r"`([^`]*)`", cells[0])] == defaults


@pytest.mark.parametrize("task", TASKS)
def test_every_key_of_info_and_every_term_of_the_reward_is_listed(task: str) -> None:
    env = gym.make(f"sumo/{task}-v0")
    env.reset(seed=0)
    info = env.step(1)[4]
    env.close()
    assert keys(table(section(page("environments/common.md"), "Info"))) == set(info)
    assert keys(table(section(page(f"environments/{task}.md"), "Reward"))) == set(info["rewards"])


@pytest.mark.parametrize("task", TASKS)
def test_levels_can_be_copied(task: str) -> None:
    shown = table(section(page(f"environments/{task}.md"), "Traffic levels of the paper"))
    assert list(shown) == list(TASKS[task].levels)
    for level, config in TASKS[task].levels.items():
        assert literal_eval(shown[level][0].strip("`")) == pytest.approx(config, rel=1e-5)


def test_risk_events_come_as_often_as_said() -> None:
    shown = table(section(page("traffic-and-risk.md"), "Risk"))
    for name, task in TASKS.items():
        r = task.risk_rates
        every = [f"{1 / rate:.0f} s" if rate else "-" for rate in (r.cut_in, r.brake, r.surge)]
        assert [cell.split(" (")[0] for cell in shown[name]] == every, name


def test_margins_of_validation() -> None:
    shown = {name: cells[0] for name, cells in table(section(page("validation.md"), "Margins")).items()}
    scale = {"unit": "", "reference": " % of highway-env's", "range": " % of its range"}
    assert shown == {
        name: f"{margin.value * (100 if margin.relative_to != 'unit' else 1):g}{scale[margin.relative_to]}"
        for name, margin in MARGINS.items()
    }


def test_keys_that_users_meet_elsewhere_are_listed() -> None:
    assert keys(table(section(page("collisions.md"), "The crash record"))) == set(
        CrashRecord.__dataclass_fields__
    )
    assert {*LEFT_OUT, *FILE_KEYS, *FIXED} <= keys(
        table(section(page("from-highway-env.md"), "Configurations"))
    )
    ours = {
        "observation",
        "action",
        "offroad_terminal",
        "screen_width",
        "screen_height",
        "centering_position",
    }
    shown = keys(table(section(page("own-parts.md"), "A network and routes")))
    assert shown == set(NetworkTask.defaults) - ours


def test_every_parameter_that_risk_changes_has_its_range() -> None:
    rows = table(section(page("traffic-and-risk.md"), "What a dose does to drivers"))
    ranges = [cells[-1] for cells in rows.values()]
    assert ranges == [
        f"{value:.0%} of drivers".replace("%", " %")
        if isinstance(value, float)
        else f"{value[0]:g} to {value[1]:g}"
        for value in asdict(RiskRanges()).values()
    ]
