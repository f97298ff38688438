"""Experiments as data: names that do not shift, levels, shards, seeds."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from agents.learners import LEARNERS
from agents.streams import episode_seed
from experiments.study.design import experiment
from experiments.study.design.arms import ARMS, DOSE_ARMS, EVERY_ARM, TEST, scenario_seed, training_seed
from experiments.study.design.cell import Cell, setting_of_agent
from experiments.study.design.experiment import Experiment
from experiments.study.design.fingerprint import known_dynamics
from experiments.study.design.levels import choose_levels, level_names
from experiments.study.design.presets import cells_of, of_preset
from experiments.study.design.sheet import GRID, VARIANTS
from experiments.study.design.traffic import unseen_traffics
from experiments.support.errors import UserError
from sumo_env.tasks import TASKS


def cells(levels: dict | None = None, **options) -> list[Cell]:
    sizes = {"preset": "own", "about": "", "seeds": 2, "episodes": 5, "gate_episodes": 5}
    asked: dict[str, Any] = {**sizes, "learners": lambda _: {"updates": 100}, **options}
    return [
        cell
        for task, numbers in (levels or {"highway": (1,)}).items()
        for cell in Experiment(tasks=(task,), levels=numbers, **asked).cells()
    ]


def test_further_arms_tests_and_policies_rename_nothing():
    usual = cells()
    further: dict[str, Any] = {
        "test_on": ("replica", "highway-env"),
        "unseen": True,
        "traffics": ("measured",),
    }
    more = cells(arms=tuple(EVERY_ARM), frontier=True, **further)
    assert {c.name for c in usual} <= {c.name for c in more}
    assert len({c.name for c in more}) == len(more)
    agents = [c for c in more if c.kind == "agent"]
    assert {c.arm for c in agents} == {*EVERY_ARM}
    tests = [c for c in more if c.kind == "test"]
    assert {c.parent.name for c in tests} == {c.name for c in agents}
    ends = ("-doses", "-unseen", "-on-replica", "-on-highway-env")
    tested = [{c.arm for c in tests if c.slug.endswith(end)} for end in ends]
    assert tested == [set(DOSE_ARMS), *[set(EVERY_ARM)] * 3]
    unseen = {tuple(c.test_on["traffics"]) for c in tests if c.slug.endswith("-unseen")}
    assert unseen == {unseen_traffics("highway"), ("measured",)}
    assert all(c.budget == (0, 0) and c.tested["episodes"] == 5 for c in tests)
    assert all(c.tested.get("dynamics", c.dynamics) == known_dynamics(c.runs_on, c.task) for c in tests)
    assert "highway-env" in next(c for c in tests if c.runs_on == "highway-env").versions
    for c in (*more, *cells(learner="sb3-dqn", test_on=("replica",))):
        of_both = c.kind == "agent" and c.arm in ARMS
        assert setting_of_agent(c.name) == ("sumo-highway-50" if of_both else ""), c.name
    policies = [{c.policy for c in found if c.kind == "baseline"} for found in (more, usual)]
    assert policies[0] - policies[1] == {"careful-0.1", "careful-0.5", "careful-2", "careful-4"}


def test_a_policy_of_one_s_own_is_named_by_what_it_is(tmp_path: Path) -> None:
    """Its code and what it reads; two of one name would share the cell's name and are refused."""
    files = [tmp_path / name / "mine.py" for name in ("a", "b")]
    for file in files:
        file.parent.mkdir()
        file.write_text(
            "from pathlib import Path\nclass Policy:\n    def act(self, seen):\n        return 1\n"
            "def make(env):\n    Path(__file__).with_name('weights').read_text()\n    return Policy()\n"
        )
        file.with_name("weights").write_text("one")
    one, two = (f"{file}:make" for file in files)

    def named(policy: str) -> str:
        [cell] = [cell for cell in cells(policy=(policy,)) if cell.source]
        return cell.name

    first = named(one)
    assert first == named(two)
    files[0].with_name("weights").write_text("two")
    assert first != named(one)
    with pytest.raises(UserError, match=r"both called mine.py:make in results: rename"):
        cells(policy=(one, two))


def test_another_study_has_other_seeds_and_scenarios():
    first, second = cells(), cells(first_seed=100, first_scenario=1000)
    assert {c.seed for c in second if c.arm} == {100, 101}
    starts = [{c.eval["first_scenario"] for c in part} for part in (first, second)]
    assert starts == [{0}, {1000}]
    assert not {c.name for c in first} & {c.name for c in second}


def test_options_set_one_key_of_an_entry_and_rules_of_the_training():
    """The other keys of the entry are the task's, whatever the order; null ends a rule of the preset."""
    features = ["presence", "x", "y", "dx", "tcpa"]
    asked = of_preset(
        Experiment,
        tasks=("two-way", "roundabout"),
        levels=(1,),
        first_seed=900,
        first_scenario=90000,
        config=("action.target_speeds=[10,20,30]", f"observation.features={json.dumps(features)}"),
        settings=("n_steps=2", "training_clock=[20,20]", "time_observed=20"),
    )
    agents = {cell.task: cell for cell in cells_of(asked) if cell.kind == "agent"}
    for task, cell in agents.items():
        usual, found = TASKS[task].defaults, cell.env_config
        assert found["observation"] == {**usual["observation"], "features": features}
        assert found["action"] == {**usual["action"], "target_speeds": [10, 20, 30]}
        of_rules = {"training_clock": [20, 20], "time_observed": 20, "horizon": 20, "n_steps": 2}
        assert cell.profile.items() >= of_rules.items()
        assert cell.seed >= 900 and cell.eval["first_scenario"] == 90000
    twice = cells_of(replace(asked, config=("policy_frequency=2",)))
    assert {cell.profile["horizon"] for cell in twice if cell.kind == "agent"} == {40}  # steps, not seconds
    ended = cells_of(replace(asked, settings=("training_clock=null", "time_observed=null")))
    assert not any({"training_clock", "time_observed"} & {*cell.profile} for cell in ended)
    assert {cell.profile["horizon"] for cell in ended if cell.kind == "agent"} == {0}
    for setting in ("training_clock=20", "training_clock=[13,15]", "time_observed=1.5"):
        with pytest.raises(UserError, match=setting.partition("=")[0]):
            cells_of(replace(asked, settings=(setting,)))


def test_features_are_seen_beside_the_task_s_own(tmp_path: Path) -> None:
    """Unless the whole observation, or its features, are configured."""

    def seen(task: str, **asked) -> list[str] | None:
        cells = cells_of(of_preset(Experiment, tasks=(task,), levels=(1,), seeds=1, **asked))
        [found] = {json.dumps(cell.env_config["observation"].get("features")) for cell in cells}
        return json.loads(found)

    usual = ["presence", "x", "y", "vx", "vy"]
    assert seen("highway", features=("tcpa", "x")) == [*usual, "tcpa"]
    assert seen("two-way-brakes", features=("tcpa",), test_on=("replica",)) == [*usual, "tcpa"]
    assert seen("intersection", features=("dx", "tcpa")) == [*usual, "cos_h", "sin_h", "dx", "tcpa"]
    assert seen("highway", features=("tcpa",), config=('observation.features=["x"]',)) == ["x"]
    assert seen("highway", features=("tcpa",), config=('observation={"type": "TimeToCollision"}',)) is None
    with pytest.raises(UserError, match="tcba"):
        seen("highway", features=("tcba",))


def test_the_name_follows_everything_that_changes_the_result_and_no_label():
    cell, *_, baseline = cells()
    assert cells(preset="quick")[0].name == cell.name
    other = cells(settings=("gamma=0.99",))
    assert other[0].name != cell.name and other[-1].name == baseline.name
    assert replace(cell, eval={"episodes": 6}).name != cell.name
    changed = cells(backend="replica", config=("risk_law=linear", "duration=7", "variant=v0"))
    assert {tuple(c.env_config[name] for name in ("risk_law", "duration", "variant")) for c in changed} == {
        ("linear", 7, "v0")
    }
    assert not {c.name for c in changed} & {c.name for c in cells(backend="replica")}


def test_a_level_that_only_some_tasks_have_is_taken_where_it_exists():
    assert choose_levels(["highway", "intersection"], [5]) == {"intersection": (5,)}


@pytest.mark.parametrize("count", [1, 2, 3, 7])
def test_shards_are_a_partition_that_keeps_the_arms_of_a_seed_together(count):
    everything = cells({"highway": (1, 2), "u-turn": (1,)}, seeds=3)
    parts = [experiment.shard(everything, f"{i}/{count}") for i in range(1, count + 1)]
    assert sorted(c.name for part in parts for c in part) == sorted(c.name for c in everything)
    home = {(c.task, c.level, c.seed): i for i, part in enumerate(parts) for c in part}
    assert all(home[c.task, c.level, c.seed] == i for i, part in enumerate(parts) for c in part)


def test_seeds_of_tests_of_gates_and_of_trainings_are_apart_from_each_other():
    episodes = {episode_seed(seed, episode) for seed in range(5) for episode in range(200)}
    places = [(task, level, number) for task in TASKS for level in (1, 2) for number in range(100)]
    trainings, tests = ({seed(*place) for place in places} for seed in (training_seed, scenario_seed))
    gates = {scenario_seed(*place, "gate") for place in places}
    assert max(episodes | trainings) < TEST <= min(tests | gates)
    assert len(trainings) == len(tests) == len(places) == len(tests | gates) / 2


@pytest.mark.parametrize("learner", LEARNERS)
def test_learners_from_elsewhere_have_the_steps_of_the_study(learner: str):
    def steps(**asked) -> dict[str, int]:
        found = cells_of(of_preset(Experiment, backend="replica", levels=(1,), arms=("control",), **asked))
        return {cell.task: cell.budget[0] for cell in found if cell.kind == "agent"}

    ours = steps(preset="study")
    assert len(ours) == 6 and steps(preset="study", learner=learner) == ours


@pytest.fixture
def study() -> list[Cell]:
    return cells_of(of_preset(Experiment, "study"))


def test_the_study_has_seeds_and_scenarios_that_no_other_preset_has(study) -> None:
    agents = [cell for cell in study if cell.kind == "agent"]
    places = {(cell.task, cell.level_name) for cell in agents}
    assert len(places) == 18 and ("two-way", "15+6") not in places
    assert len(agents) == 18 * 2 * 5
    assert {(cell.arm, cell.seed) for cell in agents} == {(a, s) for a in ARMS for s in range(800, 805)}
    asked = {"episodes": 400, "gate_episodes": 100, "first_scenario": 8000}
    assert all(cell.eval == asked for cell in study)


def test_the_study_has_the_further_tests_of_its_plan(study) -> None:
    light = {(task, level_names(task)[0]) for task in (*GRID, *VARIANTS)}
    for name, episodes in (("planner", 40), ("sumo", 400)):
        drives = [cell for cell in study if cell.policy == name]
        assert {(cell.task, cell.level_name) for cell in drives} == light
        assert {cell.tested["episodes"] for cell in drives} == {episodes}
    tests = [cell for cell in study if cell.kind == "test"]
    assert {cell.tested["episodes"] for cell in tests} == {200}
    away = [cell for cell in tests if cell.runs_on == "replica"]
    unseen = [cell for cell in tests if cell.tested["traffics"] == ["only-parameters", "measured"]]
    assert len(away) == 180 and len(unseen) == 6 * 2 * 5 and len(tests) == 240
    assert {(cell.task, cell.level_name) for cell in unseen} == light
