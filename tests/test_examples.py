"""The scripts and the notebook in examples/ run, for a few steps."""

import json
from pathlib import Path

import pytest

from tests.processes import ROOT, python_again

EXAMPLES = ROOT / "examples"
SCENARIOS = EXAMPLES / "scenarios"
NAMES = sorted(path.stem for path in SCENARIOS.glob("*.py") if path.stem not in ("build", "train"))
SCRIPTS = {
    "sb3_dqn.py": (["--steps", "120"], "risk 1: return"),
    "speed_cap.py": (["u-turn", "--quick"], "treatment 16 m/s: crashes"),
    "sb3_ppo.py": (
        [*("--steps", "128", "--envs", "8", "--rollout", "16", "--scenarios", "2"), "--save", "ppo.zip"],
        "of 2 scenarios",
    ),
    "arrive.py": (
        ["--only", "ramp/sb3-dqn/0", "--steps", "1010", "--episodes", "1"],
        "ramp/sb3-dqn/0 {'training CPU s'",
    ),
    "ppo.py": (["--steps", "96", "--envs", "2", "--rollout", "24"], "96 steps, return of the last"),
    "rl_agents_config.py": (["--steps", "30"], "observation (15, 7)"),
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


# A script with its options, where episodes and PPO's first rollout are short; two constant actions are tried.
SHORT = """
import re, sys
from pathlib import Path
sys.argv = sys.argv[1:]
sys.path.insert(0, str(Path(sys.argv[0]).parent))
import train
every = train.constants
train.SETTINGS["PPO"] |= {"n_steps": 20, "batch_size": 20}
train.constants = lambda *given: dict([*every(*given).items()][::len(every(*given)) - 1])
script = re.sub('"duration": [0-9]+', '"duration": 10', Path(sys.argv[0]).read_text())
exec(compile(script, sys.argv[0], "exec"), {"__name__": "__main__", "__file__": sys.argv[0]})
"""


@pytest.mark.parametrize("name", NAMES)
def test_a_scenario_is_short_and_can_be_trained(name: str, tmp_path: Path) -> None:
    script = SCENARIOS / f"{name}.py"
    assert len(script.read_text(encoding="utf-8").splitlines()) <= 40
    assert (SCENARIOS / "networks" / f"{name}.net.xml").is_file()
    options = "--steps", "20", "--episodes", "2", "--picture", "a.png"
    python_again("-c", SHORT, script, *options, cwd=tmp_path)
    rows = json.loads((tmp_path / "results.json").read_text())
    assert rows[name]["episodes"] == 2 and (tmp_path / "a.png").is_file()


def test_the_page_has_what_the_scenarios_gave() -> None:
    results = json.loads((SCENARIOS / "results.json").read_text())
    assert set(results) <= set(NAMES) and all(row["episodes"] == 100 for row in results.values())
    assert python_again(SCENARIOS / "train.py") in (ROOT / "docs" / "examples.md").read_text(encoding="utf-8")
