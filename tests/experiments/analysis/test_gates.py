"""The gates, one by one, on episodes made for them."""

from typing import Any

import numpy as np
import pandas as pd
import pytest

from experiments.analysis.claims import claims
from experiments.analysis.effects import slopes
from experiments.analysis.gates import gates
from experiments.analysis.scores import Arms, Setting
from experiments.study.design.sheet import SHEETS
from sumo_env.tasks import TASKS
from tests.experiments.analysis.made_up import agents, effects, find
from tests.tasks import PUBLISHED

N = 50
LUCK = np.random.default_rng(0).normal(0, 1, N)  # of the scenarios, shared by everybody
SETTING = {"backend": "sumo", "level": 1, "level_name": "1"}


def cell(policy: str, task: str, arm: str | None = None) -> dict[str, Any]:
    own = {"kind": "agent", "seed": 0} if arm else {"kind": "baseline", "seed": None}
    key = {**SETTING, "task": task, "policy": policy, "arm": arm, "profile": {}, **own}
    return {"key": key, "learner": {"probe_q": [[100, 1.0, 10.0]], "q_bound": 20.0} if arm else None}


def episodes(
    name: str, returns: Any, distance: float = 100.0, stopped: float = 0.0, traffic: str = "regular"
) -> pd.DataFrame:
    table = pd.DataFrame({"cell": name, "traffic": traffic, "scenario": np.arange(N), "return": returns})
    return table.assign(distance=distance, stopped=stopped, length=10, action_0=5, action_1=5)


def verdict(
    task: str, agent: pd.DataFrame, arm: str = "control", training: Any = (), **others: pd.DataFrame
) -> dict[str, Any]:
    cells = {"agent": cell("dqn", task, arm), **{policy: cell(policy, task) for policy in others}}
    cells["agent"]["learner"].update(training)
    [row] = gates(cells, pd.concat([agent, *others.values()])).to_dict("records")
    return {**row, "failed": row["failed"].split()}


TIED = episodes("agent", 9 + LUCK)
WAITING = episodes("agent", 9.6 + LUCK * 0.9, distance=8.0, stopped=0.8)
SLOWER = episodes("slower", 9 + LUCK)
STANDING = episodes("slower", 9.1 + LUCK, distance=5.0, stopped=0.9)
BEATEN = episodes("slower", 5 + 2 * LUCK)


@pytest.mark.parametrize(
    ("task", "agent", "others", "failed"),
    [
        # whatever actions it takes, an agent that always gets what standing gets has learnt nothing
        ("highway", TIED, {"slower": SLOWER}, ["not_constant", "beats_constant"]),
        # so has one that always acts alike
        ("highway", TIED.assign(action_0=10, action_1=0), {"slower": BEATEN}, ["not_constant"]),
        # so has one that ties with another than the best constant policy
        (
            "highway", TIED, {"slower": SLOWER, "faster": episodes("faster", 9.1 + LUCK[::-1])},
            ["not_constant", "beats_constant"],
        ),
        # waiting is a failure where crossing pays more
        ("roundabout", WAITING, {"slower": STANDING, "careful": episodes("careful", 9.4 + LUCK)}, []),
        ("roundabout", WAITING, {"slower": STANDING, "careful": episodes("careful", 9.9 + LUCK)}, ["crosses"]),
        # on a task without a crossing there is nothing to enter
        ("highway", TIED.assign(distance=0.0), {"slower": BEATEN}, []),
    ],
)  # fmt: skip
def test_what_an_agent_fails(task: str, agent: pd.DataFrame, others: Any, failed: list[str]) -> None:
    found = verdict(task, agent, **others)
    assert (found["failed"], found["passed"]) == (failed, not failed)


@pytest.mark.parametrize(("advantage", "passed"), [(0.5, True), (0.1, False), (-0.1, False)])
def test_an_agent_has_to_be_two_standard_errors_above_the_best_constant_policy(advantage, passed) -> None:
    noise = np.random.default_rng(1).normal(0, 1, N)
    noise -= noise.mean()  # the standard error of the difference is .14
    agent = episodes("agent", 9 + advantage + LUCK + noise)
    found = verdict("highway", agent, slower=SLOWER, faster=episodes("faster", 5 + LUCK))
    assert found["beats_constant"] is passed


@pytest.mark.parametrize("task", [task for task, own in SHEETS.items() if own.crossing])
def test_entering_in_half_of_the_scenarios_is_enough(task: str) -> None:
    way = np.where(np.arange(N) < N // 2, SHEETS[task].crossing + 1, SHEETS[task].crossing - 1)
    agent = episodes("agent", 9 + LUCK).assign(distance=way)
    references = {
        "slower": episodes("slower", 5 + LUCK, distance=0.0),
        "careful": episodes("careful", 20 + LUCK),
    }
    found = verdict(task, agent, **references)
    assert found["crosses"] is True


def clipped(early: float, late: float) -> dict[str, Any]:
    """Rows count by the updates that they are of: the last one is of half as many."""
    return {"goals_clipped": [[400, early], [750, early], [900, late], [950, 0.0], [1000, 2 * late]]}


def expected(value: float) -> dict[str, Any]:
    return {"values": {"episodes": 50, "expected": value, "got": 10.0, "size": 10.0}}


@pytest.mark.parametrize(
    ("gate", "training", "passed"),
    [
        ("q_bounded", {"probe_q": [[100, 1.0, 24.1]]}, False),
        ("q_bounded", {"probe_q": [[100, 1.0, 23.9]]}, True),
        ("q_bounded", {"probe_q": [[100, 1.0, None]]}, False),  # as numbers are stored that are not finite
        ("goals_inside", clipped(0.9, 0.009), True),  # before the last quarter they may be
        ("goals_inside", clipped(0.0, 0.011), False),
        *(("values_true", expected(value), True) for value in (12.4, 7.6)),
        *(("values_true", expected(value), False) for value in (12.6, 7.4)),
    ],
)
def test_what_a_training_fails(gate: str, training: dict[str, Any], passed: bool) -> None:
    found = verdict("highway", TIED, training=training, slower=BEATEN)
    assert (found[gate], found["passed"], found["failed"]) == (passed, passed, [] if passed else [gate])


def test_without_policies_to_compare_with_gates_are_open() -> None:
    record = verdict("highway", episodes("agent", 9 + LUCK))
    assert record["passed"] is None and record["failed"] == []


def test_an_agent_is_judged_in_the_traffic_that_it_was_trained_in() -> None:
    """Two points above standing in regular traffic and one or three below it in risky traffic."""

    def both(name: str, regular: float, risky: float) -> pd.DataFrame:
        return pd.concat(
            [episodes(name, regular + LUCK), episodes(name, risky + LUCK[::-1], traffic="risky")]
        )

    slower = both("slower", 9.0, 9.0)
    better, worse = both("agent", 11.0, 8.0), both("agent", 11.0, 6.0)
    assert verdict("highway", better, "mixed", slower=slower)["passed"] is True
    assert verdict("highway", worse, "mixed", slower=slower)["failed"] == ["beats_constant"]
    assert verdict("highway", worse, "control", slower=slower)["passed"] is True
    assert verdict("highway", better, "treatment", slower=slower)["failed"] == ["beats_constant"]


def made_up(**columns: Any) -> pd.DataFrame:
    """Rows of effects with what claims are made of."""
    usual = {
        "backend": "sumo",
        "task": "highway",
        "level_name": "50",
        "status": "ok",
        "se": 0.01,
        "df": 8.0,
        "detectable": 0.3,
    }
    rows = pd.DataFrame(columns)
    return rows.assign(**{name: value for name, value in usual.items() if name not in columns})


class TestClaims:
    @staticmethod
    def decide(*values: tuple[float, float], status: str = "ok", expected: int = 18) -> dict[str, Any]:
        """The verdict on "the return rises" from estimates and p-values, in so many of 18 settings."""
        p = np.array([p for _, p in values])
        rows = made_up(outcome="return", term="sum", status=status, estimate=[e for e, _ in values], p=p)
        rows["p_adjusted"] = (p * len(p)).clip(max=1)
        return find(claims(rows, slopes({})), name="return rises")

    def test_holds_if_each_does_by_itself(self) -> None:
        """Everywhere at once is the harder claim: it needs no adjustment for the number of places."""
        assert self.decide(*[(1, 0.04)] * 18)["verdict"] == "holds"
        assert self.decide(*[(1, 0.01)] * 17, (2, 0.06))["verdict"] == "not decided"

    def test_contradicted_only_after_adjustment(self) -> None:
        assert self.decide(*[(1, 0.001)] * 17, (-2, 0.04))["verdict"] == "not decided"
        found = self.decide(*[(1, 0.001)] * 17, (-2, 0.001))
        assert (found["verdict"], found["right"], found["wrong"]) == ("contradicted", 17, 1)

    def test_places_that_were_not_run_keep_it_open(self) -> None:
        found = self.decide((1, 0.001), (2, 0.001))
        assert (found["verdict"], found["right"], found["not_run"]) == ("not decided", 2, 16)

    @pytest.mark.parametrize("status", ["degenerate", "one seed", "no information"])
    def test_what_is_no_evidence_counts_neither_way(self, status: str) -> None:
        found = self.decide((-2, 0.001), status=status)
        assert (found["verdict"], found["wrong"], found["silent"]) == ("not decided", 0, 1)

    @pytest.mark.parametrize(
        ("estimate", "verdict"), [(0.001, "holds"), (0.05, "not decided"), (0.2, "contradicted")]
    )
    def test_little_harm_is_an_equivalence(self, estimate: float, verdict: str) -> None:
        rows = made_up(outcome="crashed", term="regular", estimate=[estimate] * 18, p=0.01, p_adjusted=0.01)
        assert find(claims(rows, slopes({})), name="little harm")["verdict"] == verdict

    def test_signs_are_those_of_the_claims(self) -> None:
        """An effect that raises return and crash rate, both of which rise with traffic."""
        arms: dict[Setting, Arms] = {}
        for task in PUBLISHED:
            definition = TASKS[task]
            own = agents(
                len(definition.levels), 8, np.random.default_rng(6), effect=3.0, spread=0.1, task=task
            )
            for (_, _, level, _), pair in own.items():
                for arm in pair.values():
                    for name in ("return", "crashed"):
                        arm[name][...] += level
            arms |= own
        found = claims(effects(arms), slopes(arms)).set_index("name")["verdict"]
        assert found["return rises"] == "holds"
        assert found["return falls with traffic"] == "contradicted"
        assert found["fewer crashes"] == "contradicted"
        assert found["crashes rise with traffic"] == "holds"
        assert found["little harm"] == "contradicted"
