"""Is an agent worth comparing? Six gates that a trained agent has to pass before its effect means anything.

A learner that diverged behaves like a constant, and a pair of diverged arms gives an effect of exactly 0 that no test
of significance notices. Agents that fail are shown, and the effects they enter are called uninformative. The gates are
judged on scenarios of their own: chosen by the test scenarios, the agents left over would be the lucky ones.

By some plans all agents together are checked too, before anything is compared: has the learner finished, did it
learn, does it know when a test ends? Failed checks are reported with the effects; nothing is excluded.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from scipy import stats

from experiments.analysis.estimate import DEGENERATE, OK, Estimate, combine, equal_task_weights, mean_of_units
from experiments.analysis.plan import ALPHA, Learner, Plan
from experiments.analysis.scores import in_order
from experiments.study.design.arms import ARMS, gate_traffics
from experiments.study.design.sheet import GRID, sheet, task_of
from experiments.study.results.loaded import AGENT, SETTING, table_of

Q_SLACK = 1.2  # values may overshoot what the rewards allow by a fifth before an agent counts as diverged
CLIPPED = 0.01  # share of the goals in the last quarter of a training from which its values are held by the clip alone
# Distance of values from what comes of them, as a share of its size. A crash costs what the value says is still to
# come: values a quarter too high or low price it a quarter wrong. Seven published agents are within .02 to .21.
DISTANCE = 0.25
CONSTANT = 0.98  # share of the steps with the most common action from which a policy counts as constant
TIED = 0.98  # share of the scenarios with the return of one constant policy from which an agent is tied
ENTERING = 0.5  # share of the scenarios in which a policy has to enter the crossing to count as one that does
CONSTANT_POLICIES = ("idle", "random", "faster", "slower")  # what learning has to be worth more than

GATES: dict[str, str] = {
    "q_bounded": f"Q-values stay below {Q_SLACK} x max |r| / (1 - gamma) on the probe states",
    "goals_inside": f"in the last quarter of the training less than {CLIPPED:.0%} of the goals are beyond what rewards "
    "allow, and clipped",
    "values_true": f"the value at the start of an episode is on average within {DISTANCE:.0%} of the discounted return "
    "that follows",
    "not_constant": f"no action is chosen in {CONSTANT:.0%} or more of the steps, and in less than {TIED:.0%} of the "
    "scenarios the return is that of one and the same constant policy",
    "crosses": f"enters the roundabout or intersection in {ENTERING:.0%} or more of the scenarios of its training "
    "traffic, or has a higher return there than every reference policy that does",
    "beats_constant": "return in its training traffic is above that of the best of idle, random, faster and slower by "
    "more than 2 standard errors",
}
COMPETENT = {"score": 0.8, "crashed": 0.05}  # at least and at most, see `competence`
THRESHOLDS: dict[str, Any] = {  # what decides in them, for a plan's digest
    "q_bounded": Q_SLACK,
    "goals_inside": CLIPPED,
    "values_true": DISTANCE,
    "not_constant": [CONSTANT, TIED],
    "crosses": {"entering": ENTERING, "way": {task: sheet(task).crossing for task in GRID}},
    "beats_constant": 2,
    "competent": COMPETENT,
}
FAILURES: dict[str, str] = {  # what it means to fail, in two or three words
    "q_bounded": "diverged",
    "goals_inside": "goals clipped",
    "values_true": "values do not come true",
    "not_constant": "constant policy",
    "crosses": "does not cross",
    "beats_constant": "not above a constant policy",
}
# Of the learner's record, what a gate is about: not asked of other learners, nor of agents from before it was kept.
ABOUT = {"q_bounded": "probe_q", "goals_inside": "goals_clipped", "values_true": "values"}
CHECKS = ["backend", "check", "task", "arm", "agents", "estimate", "low", "high", "least", "most", "passed"]


def _q_bounded(learner: Mapping[str, Any]) -> bool | None:
    curve, largest = learner.get("probe_q") or [], learner.get("q_bound")
    if not curve or largest is None:
        return None
    values = [math.inf if row[2] is None else row[2] for row in curve]  # JSON knows no infinity
    return max(values) <= Q_SLACK * float(largest)


def _goals_inside(learner: Mapping[str, Any]) -> bool | None:
    if not (rows := learner.get("goals_clipped")):
        return None
    updates, shares = np.array(rows, float).T
    # rows of the last quarter, by their length
    goals = np.diff(updates, prepend=0) * (updates > 0.75 * updates[-1])
    return bool(goals @ shares / goals.sum() < CLIPPED)


def _values_true(learner: Mapping[str, Any]) -> bool | None:
    if not (values := learner.get("values")):
        return None
    return abs(values["expected"] - values["got"]) <= DISTANCE * float(values["size"])


def _not_constant(own: pd.DataFrame, constant: pd.DataFrame) -> bool:
    counts = own.filter(like="action_").sum()
    share = counts.max() / counts.sum()
    if constant.empty:
        return bool(share < CONSTANT)
    ties = np.isclose(constant.sub(own["return"], axis=0), 0.0, atol=1e-9).mean(axis=0)
    return bool(share < CONSTANT and ties.max() < TIED)


def _crosses(task: str, own: pd.DataFrame, references: Iterable[pd.DataFrame]) -> bool | None:
    """Waiting is a failure only where something that crosses is worth more."""

    def enters(episodes: pd.DataFrame) -> bool:
        return bool((episodes["distance"] >= way).mean() >= ENTERING)

    if (way := sheet(task).crossing) is None or enters(own):
        return True
    crossing = [float(rows["return"].mean()) for rows in references if enters(rows)]
    return float(own["return"].mean()) > max(crossing) if crossing else None


def _beats_constant(own: pd.DataFrame, constant: pd.DataFrame) -> bool | None:
    """Compared on the same scenarios, so that their noise cancels."""
    if constant.empty:
        return None
    difference = (own["return"] - constant[constant.mean().idxmax()]).dropna()
    if len(difference) < 2:
        return None
    return float(difference.mean()) > 2 * float(difference.std(ddof=1)) / math.sqrt(len(difference))


def gates(cells: Mapping[str, Mapping[str, Any]], episodes: pd.DataFrame) -> pd.DataFrame:
    """The verdict on every trained agent.

    Args:
        cells: cell.json by name. episodes: the gate episodes of all of them, as in `loaded.Results`.

    Returns:
        A row an agent: cell, SETTING, arm, seed, passed (False if any gate fails, None if one could not be checked,
        True otherwise), failed (the names of the gates), and the same verdict for each of GATES.
    """
    judged = episodes.set_index(["traffic", "scenario"]).filter(regex="^(cell|return|distance|action_.+)$")
    tables = dict(list(judged.sort_index().groupby("cell", sort=False)))
    keys = table_of({name: cells[name] for name in tables})
    references, rows = keys[keys["kind"] != "agent"], []
    for (*setting, arm), alike in keys[keys["kind"] == "agent"].groupby([*SETTING, "arm"], sort=False):
        traffics = list(gate_traffics(arm))  # of their training
        there = references[(references[SETTING] == setting).all(axis=1)]
        others = {policy: tables[cell].loc[traffics] for cell, policy in there["policy"].items()}
        constant = pd.DataFrame(
            {policy: others[policy]["return"] for policy in CONSTANT_POLICIES if policy in others}
        )
        for name, seed in alike["seed"].items():
            own, record = tables[name].loc[traffics], cells[name].get("learner") or {}
            found = {
                "q_bounded": _q_bounded(record),
                "goals_inside": _goals_inside(record),
                "values_true": _values_true(record),
                "not_constant": _not_constant(own, constant),
                "crosses": _crosses(setting[1], own, others.values()),
                "beats_constant": _beats_constant(own, constant),
            }
            failed = " ".join(gate for gate, passed in found.items() if passed is False)
            unasked = {gate for gate, part in ABOUT.items() if record and part not in record}
            is_open = any(passed is None for gate, passed in found.items() if gate not in unasked)
            sound = False if failed else None if is_open else True
            rows.append([name, *setting, arm, seed, sound, failed, *found.values()])
    frame = pd.DataFrame(rows, columns=["cell", *AGENT, "passed", "failed", *GATES])
    return in_order(frame, "backend", "task", "level", "arm", "seed")


def learner_checks(
    cells: Mapping[str, Mapping[str, Any]],
    passed: pd.DataFrame,
    agents: pd.DataFrame,
    plan: Plan,
) -> pd.DataFrame:
    """What the plan asks of the learner, of all agents of both arms; nothing where it does not ask.

    Args:
        cells: cell.json by name. passed: from `gates.gates`. agents: the test episodes of trained agents, from
            `scores.with_outcomes`.

    Returns:
        A row a check: backend, check, task and arm (empty: all), agents, estimate, low and high (95 % interval, where
        there is one), least and most (what it has to lie between), and passed (None where the interval leaves it open):
        "change": of the training return over the last quarter of the budget, in units of its range, tasks alike;
        "diverged": agents whose values do; "gates": share of the agents that pass all;
        "last second": its rate of crashes over that of the seconds before.
    """
    rows: list[list[Any]] = []
    if (rules := plan.learner) is None:
        return pd.DataFrame(columns=CHECKS)
    passed = passed[passed["arm"].isin(ARMS) & plan.covers(passed)]
    for backend, own in passed.groupby("backend", sort=False):
        for arm in ARMS:
            trained = [cells[name] for name in own.loc[own["arm"] == arm, "cell"]]
            if trained:
                found, most = change(trained, rules), rules.change
                outside = found.low > most or found.high < -most
                verdict = False if outside else True if max(-found.low, found.high) <= most else None
                limits = found.estimate, found.low, found.high
                rows.append([backend, "change", "", arm, len(trained), *limits, -most, most, verdict])
        bad = int((own["q_bounded"].astype(object) == False).sum())  # noqa: E712
        rows.append([backend, "diverged", "", "", len(own), bad, np.nan, np.nan, 0, 0, bad == 0])
        share = float((own["passed"].astype(object) == True).mean())  # noqa: E712
        sound = share >= rules.passing
        rows.append([backend, "gates", "", "", len(own), share, np.nan, np.nan, rules.passing, 1, sound])
        tests = agents[(agents["backend"] == backend) & agents["arm"].isin(ARMS) & plan.covers(agents)]
        for (task, arm), drives in tests.groupby(["task", "arm"], sort=False):
            if task in rules.clocked:
                found = last_second(drives, rules.before)
                number = drives["cell"].nunique()
                same = bool(found.low <= 1 <= found.high) if found.status == OK else None
                limits = found.estimate, found.low, found.high
                rows.append([backend, "last second", task, arm, number, *limits, 1, 1, same])
    return pd.DataFrame(rows, columns=CHECKS)


def change(trained: Sequence[Mapping[str, Any]], rules: Learner) -> Estimate:
    """Change of the training return over the last quarter of the budget, in units of its range, tasks alike.

    Of each agent the mean over the last tenth of its learning curve, minus that over the tenth before three quarters.

    Args:
        trained: cell.json of the agents of an arm.
    """
    rows = []
    for cell in trained:
        key, curve = cell["key"], np.array(cell["learner"]["curve"]["return"], dtype=float)
        tenth, quarter = len(curve) // 10, 3 * len(curve) // 4
        # a part in which no episode ended has no return
        difference = np.nanmean(curve[-tenth:]) - np.nanmean(curve[quarter - tenth : quarter])
        rows.append([key["task"], key["level"], float(difference) / rules.ranges[task_of(key["task"])]])
    frame = pd.DataFrame(rows, columns=["task", "level", "change"])
    settings = mean_of_units(frame.groupby(["task", "level"], sort=False)["change"]).assign(arm="")
    [found] = combine(settings, ["arm"], equal_task_weights(settings, ["arm"])).itertuples()
    return found


def last_second(drives: pd.DataFrame, before: float) -> Estimate:
    """Rate of crashes per second driven in the last second of a test, over that in so many seconds before it.

    The interval of the ratio's logarithm has the variance between agents, and at least that of so few crashes that
    happen independently; half a crash is added to both counts. Degenerate where nobody drives so long.

    Args:
        drives: test episodes of one arm. before: [s].
    """
    end, time = drives["seconds"], drives["crash_free_time"]
    counts = {}
    for name, begin, until in (("last", end - 1, end), ("before", end - 1 - before, end - 1)):
        counts[name] = (drives["crashed"] > 0) & (time > begin) & (time <= until)
        counts[f"{name} driven"] = (time.clip(upper=until) - begin).clip(lower=0)
    agents = pd.DataFrame(counts).groupby(drives["cell"]).sum().astype(float)
    total = agents.sum()
    if not (total["last driven"] and total["before driven"]):
        return Estimate(np.nan, status=DEGENERATE)
    sides = [(agents[name], agents[f"{name} driven"], total[name] + 0.5) for name in ("last", "before")]
    rates = [crashes / driven.sum() for _, driven, crashes in sides]
    parts = [(own - rate * driven) / n for (own, driven, n), rate in zip(sides, rates, strict=True)]
    number = len(agents)
    between = float(((parts[0] - parts[1]) ** 2).sum()) * number / max(number - 1, 1)
    least = sum(1 / n for *_, n in sides)
    half = float(stats.t.ppf(1 - ALPHA / 2, max(number - 1, 1)) * np.sqrt(max(between, least)))
    ratio = rates[0] / rates[1]
    return Estimate(ratio, low=float(ratio * np.exp(-half)), high=float(ratio * np.exp(half)))
