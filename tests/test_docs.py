"""The documentation says what the code does: keys and defaults, parameters of drivers, ids, commands, links."""

from __future__ import annotations

import ast
import importlib.util
import re
from dataclasses import asdict
from pathlib import Path
from typing import Any

import gymnasium as gym
import pytest

import sumo_env
from experiments.validation.margins import MARGINS
from sumo_env.config import COMMON, FILE_KEYS, FIXED, LEFT_OUT
from sumo_env.contacts.crash import CrashRecord
from sumo_env.sumo.events import modes
from sumo_env.tasks import TASKS
from sumo_env.tasks.base import Task
from sumo_env.tasks.network import NetworkTask
from sumo_env.traffic.drivers import Calibration, RiskRanges, vehicle_type
from sumo_env.traffic.risk import RiskRates
from tests.pages import PAGES, ROOT, TEXTS, section, table
from tests.sumo_env.scenarios import drivers

names = [str(page.relative_to(ROOT)) for page in PAGES]
each_page = pytest.mark.parametrize("page", PAGES, ids=names)
each_task = pytest.mark.parametrize("task", TASKS)


def environment(task: str) -> str:
    """The page of a task."""
    return TEXTS[ROOT / "docs" / "environments" / f"{task}.md"]


def literal(cell: str) -> Any:
    """The value that a cell shows in backticks."""
    return ast.literal_eval(cell.strip("`"))


# -- environments ------------------------------------------------------------------------------------------------------


@each_task
def test_every_key_of_the_configuration_is_listed_with_its_default(task: str) -> None:
    shown = {
        key: literal(cells[0]) for key, cells in table(section(environment(task), "Configuration")).items()
    }
    actual = {**COMMON, **TASKS[task].defaults}
    assert shown.pop("scaling") == pytest.approx(actual.pop("scaling"))
    assert shown == actual


@each_task
def test_every_key_of_info_and_every_term_of_the_reward_is_listed(task: str) -> None:
    env = gym.make(f"sumo/{task}-v0")
    env.reset(seed=0)
    info = env.step(1)[4]
    env.close()
    listed = table(section(environment(task), "Info"))
    assert set(listed) == set(info)
    assert {key: cells[0] for key, cells in listed.items()} == {k: type(v).__name__ for k, v in info.items()}
    assert set(table(section(environment(task), "Reward"))) == set(info["rewards"])


@each_task
def test_actions_and_shape_of_the_observation(task: str) -> None:
    env = gym.make(f"sumo/{task}-v0")
    actions = {str(k): [name] for k, name in env.unwrapped.actions.items()}  # type: ignore[attr-defined]
    assert table(section(environment(task), "Actions")) == actions
    assert f"of shape {env.observation_space.shape}" in " ".join(
        section(environment(task), "Observation").split()
    )


@each_task
def test_levels_can_be_copied(task: str) -> None:
    shown = {
        level: literal(cells[0])
        for level, cells in table(section(environment(task), "Traffic levels")).items()
    }
    assert list(shown) == list(TASKS[task].levels)
    for level, config in TASKS[task].levels.items():
        assert shown[level] == pytest.approx(config, rel=1e-5)


@each_task
def test_the_parameters_of_the_drivers_are_those_of_their_vehicle_types(task: str) -> None:
    regular = drivers(task, 0.0)
    types = [vehicle_type(driver, TASKS[task].calibration) for driver in regular]
    spec = TASKS[task].scenario({**COMMON, **TASKS[task].defaults}, 0).vehicles[0]
    speed_mode, lane_change_mode = modes(spec, TASKS[task].calibration)
    calibration = TASKS[task].calibration
    expected = {
        "delta": "`4`" if TASKS[task].fixed_delta else "`3.5` to `4.5`",
        "speed mode": f"`{speed_mode}`",
        "lane-change mode": f"`{lane_change_mode}`",
        "jmIgnoreFoeProb": f"`1` for {calibration.ignores_approaching:.0%} of drivers".replace("%", " %"),
        "jmIgnoreJunctionFoeProb": f"`1` for {calibration.ignores_inside:.0%} of drivers".replace("%", " %"),
    }
    rows = {
        key.strip("` "): cells[0]
        for names, cells in table(section(environment(task), "The other drivers")).items()
        for key in names.split(",")
    }
    for key, shown in rows.items():
        if key in expected:
            assert shown == expected[key], key
        elif not key.startswith("visibility"):
            (value,) = {attributes[key] for attributes in types}
            cell = shown.strip("`")
            assert cell == value or float(cell) == float(value), key
    assert ("jmIgnoreFoeProb" in rows) == (calibration.ignores_approaching > 0)
    assert ("jmIgnoreJunctionFoeProb" in rows) == (calibration.ignores_inside > 0)
    assert ("lcSpeedGain" in rows) == calibration.lane_changes


# -- risk --------------------------------------------------------------------------------------------------------------

RISK = ROOT / "docs" / "traffic-and-risk.md"


def test_calibrated_settings() -> None:
    """Every number of a task's calibration stands in its row."""
    rows = table(section(TEXTS[RISK], "Calibration"))
    for name, task in TASKS.items():
        changed = {k: v for k, v in asdict(task.calibration).items() if v != asdict(Calibration())[k]}
        numbers = [
            f"{value:.0%}".replace("%", " %") if key.startswith("ignores") else f"{value:g}"
            for key, value in changed.items()
            if not isinstance(value, bool)
        ]
        assert all(
            re.search(rf"(?<![\d.]){re.escape(number)}(?![\d.])", rows[name][0]) for number in numbers
        ), name
        assert ("no lane changes" in rows[name][0]) == (
            not task.calibration.lane_changes and name != "intersection"
        )


def test_ranges_of_risky_parameters() -> None:
    shown = {key: cells[-1] for key, cells in table(section(TEXTS[RISK], "Parameters")).items()}
    expected = {
        name: f"{value:.0%} of drivers".replace("%", " %")
        if isinstance(value, float)
        else f"{value[0]:g} to {value[1]:g}"
        for name, value in asdict(RiskRanges()).items()
    }
    assert shown == expected


def test_rates_of_risk_events() -> None:
    shown = {
        key: [cell.strip("`") for cell in cells]
        for key, cells in table(section(TEXTS[RISK], "Events")).items()
    }
    for name, task in TASKS.items():
        r: RiskRates = task.risk_rates
        assert shown[name] == [
            f"{r.cut_in:g}" if r.cut_in else "-",
            f"{r.brake:g} ({r.brake_decel:g} m/s², {r.brake_duration:g} s)" if r.brake else "-",
            f"{r.surge:g} ({r.surge_accel:g} m/s², {r.surge_duration:g} s, {r.surge_way:g} m)"
            if r.surge
            else "-",
        ]


def test_ranges_of_a_task_s_own() -> None:
    lines = section(TEXTS[RISK], "Parameters").splitlines()
    header = next(line for line in lines if line.startswith("| task |"))
    parameters = [cell.strip(" `") for cell in header.split("|")[2:-1]]
    for name, task in TASKS.items():
        own = {
            parameter: f"{100 * value:g} %" if isinstance(value, float) else f"{value[0]:g} to {value[1]:g}"
            for parameter, value in asdict(task.risk_ranges).items()
            if value != asdict(RiskRanges())[parameter]
        }
        shown = next((line for line in lines if line.startswith(f"| {name} |")), None)
        cells = [cell.strip() for cell in shown.split("|")[2:-1]] if shown else []
        found = {p: cell for p, cell in zip(parameters, cells, strict=False) if cell != "as above"}
        assert found == own, name


def test_margins_of_validation() -> None:
    shown = {
        key: cells[0]
        for key, cells in table(section(TEXTS[ROOT / "docs" / "validation.md"], "Margins")).items()
    }
    scale = {"unit": "", "reference": " % of highway-env's", "range": " % of its range"}
    expected = {
        name: f"{margin.value * (100 if margin.relative_to != 'unit' else 1):g}{scale[margin.relative_to]}"
        for name, margin in MARGINS.items()
    }
    assert shown == expected


def test_the_fields_of_the_crash_record() -> None:
    shown = table(section(TEXTS[ROOT / "docs" / "collisions.md"], "The crash record"))
    assert {key.strip("` ") for keys in shown for key in keys.split(",")} == set(
        CrashRecord.__dataclass_fields__
    )


# -- what is named exists ----------------------------------------------------------------------------------------------


@each_page
def test_ids_exist(page: Path) -> None:
    assert set(re.findall(r"sumo/[a-z-]+-v\d", TEXTS[page])) <= set(sumo_env.IDS)


def test_the_readme_lists_all_ids() -> None:
    rows = " ".join(table(section(TEXTS[ROOT / "README.md"], "The environments")))
    assert set(re.findall(r"sumo/[a-z-]+-v\d", rows)) == set(sumo_env.IDS)


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
    for link in re.findall(r"\]\(([^)\s]+)\)", TEXTS[page]):
        if link.startswith(("http://", "https://")):
            continue
        file, _, anchor = link.partition("#")
        target = (page.parent / file).resolve() if file else page
        assert target.exists(), link
        if anchor:
            assert anchor in anchors(target.read_text(encoding="utf-8")), link


@each_page
@pytest.mark.slow
def test_examples_run(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    shared: dict[str, Any] = {}
    for block in re.findall(r"^```python\n(.*?)^```", TEXTS[page], re.DOTALL | re.MULTILINE):
        code = block.replace("10_000", "150")  # training steps
        exec(compile(code, str(page), "exec"), shared)


# -- what users bring --------------------------------------------------------------------------------------------------


def test_the_keys_of_highway_env_that_are_left_out_or_fixed() -> None:
    rows = table(section(TEXTS[ROOT / "docs" / "from-highway-env.md"], "Configurations"))
    listed = {key.strip("` ") for keys in rows for key in keys.split(",")}
    assert {*LEFT_OUT, *FILE_KEYS, *FIXED} <= listed
    for key, (value, _) in FIXED.items():
        (cell,) = (cells[0] for keys, cells in rows.items() if keys.strip("`") == key)
        assert str(value) in cell, key


def test_the_keys_of_a_network_of_one_s_own() -> None:
    rows = table(section(TEXTS[ROOT / "docs" / "own-parts.md"], "A network and routes"))
    shown: dict[str, Any] = {}
    for keys, cells in rows.items():
        names = [key.strip("` ") for key in keys.split(",")]
        values = [literal(value) for value in re.findall(r"`[^`]*`", cells[0])]
        shown |= dict(zip(names, values, strict=False))
    assert shown == {key: NetworkTask.defaults[key] for key in shown}
    known = {
        "observation",
        "action",
        "offroad_terminal",
        "screen_width",
        "screen_height",
        "centering_position",
    }
    assert set(NetworkTask.defaults) - known == set(shown)


def test_the_attributes_of_a_task() -> None:
    rows = table(section(TEXTS[ROOT / "docs" / "own-parts.md"], "A task"))
    listed = {name for keys in rows for name in re.findall(r"([a-z_]+)(?:`|\(|,|$)", keys)}
    assert {name for name in listed if name not in ("config", "road", "rng", "drivers", "seed", "ego", "rewards")} <= {
        *vars(Task), *Task.__annotations__
    }  # fmt: skip
