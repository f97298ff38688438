"""The scripts and the notebook in examples/ run, for a few steps."""

from __future__ import annotations

import json
from pathlib import Path
from statistics import median

import pytest

from tests.processes import ROOT, python_again

EXAMPLES = ROOT / "examples"
SCENARIOS = EXAMPLES / "scenarios"
NAMES = sorted(path.stem for path in SCENARIOS.glob("*.py") if path.stem not in ("build", "train"))
SCRIPTS = {
    "sb3_dqn.py": (["--steps", "120"], "risk 1: return"),
    "sb3_ppo.py": (
        ["--steps", "128", "--envs", "8", "--rollout", "16", "--scenarios", "2"],
        "of 2 scenarios",
    ),
    "arrive.py": (
        ["--only", "ramp/sb3-dqn/0", "--steps", "1010", "--episodes", "1"],
        "ramp/sb3-dqn/0 {'training CPU s'",
    ),
    "ppo.py": (["--steps", "96", "--envs", "2", "--rollout", "24"], "96 steps, return of the last"),
    "rl_agents_config.py": (["--steps", "30"], "observation (15, 7)"),
    "several_cars.py": (["--steps", "700", "--episodes", "2", "--seeds", "0"], '"trained, greedy"'),
    "torchrl_rollout.py": (["--steps", "12"], "torch.Size([12, 5, 5])"),
}

pytestmark = pytest.mark.slow


def test_every_example_is_listed_and_tested() -> None:
    listed = (EXAMPLES / "README.md").read_text(encoding="utf-8")
    files = {path.name for path in EXAMPLES.iterdir() if path.suffix in (".py", ".json", ".ipynb")}
    assert {name for name in files if f"`{name}`" not in listed} == set()
    assert {name for name in files if name.endswith(".py")} == set(SCRIPTS)


@pytest.mark.parametrize("name", SCRIPTS)
def test_a_script_runs(name: str, tmp_path: Path) -> None:
    arguments, expected = SCRIPTS[name]
    assert expected in python_again(EXAMPLES / name, *arguments, cwd=tmp_path)


def test_the_table_of_arrivals_is_what_was_measured() -> None:
    """Arrivals at risk 0 / at risk 1 in `arrive.json`; of agents the median of the trainings, of constants the most."""
    lines = json.loads((EXAMPLES / "arrive.json").read_text(encoding="utf-8"))
    page = (ROOT / "docs" / "examples.md").read_text(encoding="utf-8")
    title, _, *table = page.partition("| driver |")[2].partition("\n\n")[0].splitlines()
    scenarios = dict(zip(title.replace("|", " ").split(), ("ramp", "grid", "town"), strict=True))
    constants = ("LANE_LEFT", "IDLE", "LANE_RIGHT", "FASTER", "SLOWER")
    drivers = {
        **{
            "double DQN of this project": ("dqn",),
            "DQN of Stable-Baselines3": ("sb3-dqn",),
            "SUMO": ("SUMO",),
        },
        **{"careful driver of `agents/rules`": ("careful",), "always IDLE": ("IDLE",)},
        "the best constant action": constants,
    }
    cells = 0
    for row in table:
        driver, *shown = [cell.strip() for cell in row.strip("|").split("|")]
        names = drivers.pop(driver)
        several = max if names == constants else median
        for scenario, cell in zip(scenarios.values(), shown, strict=True):
            of = [
                lines[key] for key in lines for name in names if f"{key}/".startswith(f"{scenario}/{name}/")
            ]
            counts = [[line[f"risk {risk}"].get("arrived", 0) for line in of] for risk in (0, 1)]
            assert cell == (" / ".join(f"{several(arrived):g}" for arrived in counts) if of else "")
            cells += bool(of)
    assert not drivers and cells == 17  # Braunschweig: one of the two learners


def test_the_notebook_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    notebook = json.loads((EXAMPLES / "tour.ipynb").read_text(encoding="utf-8"))
    shared: dict[str, object] = {}
    for cell in notebook["cells"]:
        if cell["cell_type"] == "code":
            assert cell["outputs"]
            code = "".join(cell["source"]).replace("EPISODES = 30", "EPISODES = 1")
            exec(compile(code, cell["id"], "exec"), shared)
    assert (tmp_path / "episode" / "episode.sumocfg").is_file()


@pytest.mark.parametrize("name", NAMES)
def test_a_scenario_is_short_and_can_be_trained(name: str, tmp_path: Path) -> None:
    script = SCENARIOS / f"{name}.py"
    assert len(script.read_text(encoding="utf-8").splitlines()) <= 40
    assert (SCENARIOS / "networks" / f"{name}.net.xml").is_file()
    python_again(script, "--steps", "20", "--episodes", "2", "--picture", "a.png", cwd=tmp_path)
    rows = json.loads((tmp_path / "results.json").read_text())
    assert rows[name]["episodes"] == 2 and (tmp_path / "a.png").is_file()


def test_cars_of_a_platoon_are_paid_their_mean_and_end_in_a_crash() -> None:
    """Beside PettingZoo's environment: the same rewards, and zeros for cars that have crashed."""
    code = """
import platoon, train
one, other = train.Several(platoon.make()), platoon.make()
rows, _ = one.reset(seed=0)
other.reset(seed=0)
left = set()
while other.agents:
    seen, rewards, *_ = other.step({agent: [1.0] for agent in other.agents})
    rows, reward, over, _, info = one.step([1.0])
    assert abs(reward - sum(rewards.values()) / 3) < 1e-9 and over == (not other.agents)
    for agent, row in zip(other.possible_agents, rows):
        assert (row == (seen[agent] if agent in other.agents else 0.0)).all()
    left.add(len(other.agents))
print(info, sorted(left))
"""
    assert python_again("-c", code, cwd=SCENARIOS).startswith("{'crashed': True} [0, ")


def test_the_page_has_what_the_scenarios_gave() -> None:
    results = json.loads((SCENARIOS / "results.json").read_text())
    assert set(results) <= set(NAMES) and all(row["episodes"] == 100 for row in results.values())
    assert python_again(SCENARIOS / "train.py") in (ROOT / "docs" / "examples.md").read_text(encoding="utf-8")
