"""Learners from elsewhere beside our arms, on the same scenarios."""

from __future__ import annotations

from pathlib import Path

import pytest

from experiments.learners import LEARNERS, OURS, RL_AGENTS, Options, cells, compare, environment_steps
from experiments.support.errors import UserError


def test_all_get_the_environment_steps_the_seeds_and_the_scenarios_of_the_preset() -> None:
    options = Options(learners=(*OURS, *RL_AGENTS))
    agents = [cell for cell in cells(options, "u-turn") if cell.kind == "agent"]
    assert {cell.seed for cell in agents} == {100, 101, 102}
    assert len(agents) == 3 * 5 and len({cell.name for cell in agents}) == len(agents)
    assert {(cell.episodes, cell.first_scenario, cell.backend) for cell in agents} == {(400, 1000, "replica")}
    profiles = [cell.profile for cell in agents]
    steps = {p["warm_up"] + p["steps_per_update"] * p["updates"] for p in profiles}
    assert steps == {environment_steps(options, "u-turn")}


@pytest.mark.slow
def test_every_learner_is_trained_once_and_tested(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    options = Options(tmp_path, preset="smoke", tasks=("u-turn",), seeds=1, episodes=2, workers=2)
    assert compare(options, []) == 0
    table = capsys.readouterr().out.partition("\nu-turn\n")[2]
    drivers = {line.split()[0]: line for line in table.splitlines()[3:]}
    assert {*LEARNERS, "careful"} <= set(drivers)
    assert all("±" not in drivers[name] for name in LEARNERS)  # one training has no standard error
    written = {file: file.stat().st_mtime_ns for file in tmp_path.glob("*/*")}
    assert compare(options, []) == 0
    assert written == {file: file.stat().st_mtime_ns for file in tmp_path.glob("*/*")}
    assert capsys.readouterr().out.partition("\nu-turn\n")[2] == table


def test_what_does_not_exist_is_named() -> None:
    with pytest.raises(UserError, match=r"did you mean .sb3-dqn"):
        compare(Options(learners=("sb3-dqm",)), [])
