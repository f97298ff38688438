"""Can the control agents of a setting drive well enough for its effect to be about driving?

A setting is competent where its control agents, in regular traffic and in the scenarios of the gates, return no less
than every driver of fixed rules with the same actions, score at least LEAST, and crash in at most MOST of the episodes
if a policy without foresight and with the same actions never does. Marks are those of `design.attainable`: from other
scenarios, fixed before the plan. All agents count, competent or not; a second table holds the competent settings.
"""

from collections.abc import Mapping
from typing import Any

import pandas as pd

from agents.rules import MAKERS
from experiments.analysis.gates import COMPETENT
from experiments.analysis.plan import Places
from experiments.analysis.scores import in_order, is_marked
from experiments.study.design import attainable
from experiments.study.design.attainable import CONSTANT, MORE, POLICY
from experiments.study.results.loaded import SETTING

LEAST = COMPETENT["score"]
MOST = COMPETENT["crashed"]  # share of the episodes
TRAFFIC = "regular"
FORESEEING = ("planner", "clairvoyant")  # are no rules: their marks are in the score
WORDS = {"return": "below a rule", "score": f"score below {LEAST:g}", "crashed": f"crashes above {MOST:.0%}"}
COLUMNS = [*SETTING, "agents", "return", "score", "crashed", "rule", "rule_return"]
COLUMNS += ["unfair", "competent", "failed"]


def competence(cells: Mapping[str, Mapping[str, Any]], episodes: pd.DataFrame) -> pd.DataFrame:
    """The verdict on every setting that has marks.

    Args:
        cells: cell.json by name. episodes: of the gates, as in `loaded.Results`.

    Returns:
        A row a SETTING: agents (their number), return, score and crashed (means of the control agents), rule and
        rule_return (the best driver of fixed rules), unfair (whether SUMO's driver has more actions, and is not asked),
        competent, and failed (the names in WORDS of what it lacks).
    """
    asked = {name for name, cell in cells.items() if is_marked(cell["key"])}
    own = episodes[
        episodes["cell"].isin(asked) & (episodes["arm"] == "control") & (episodes["kind"] == "agent")
    ]
    rows = []
    for setting, there in own[own["traffic"] == TRAFFIC].groupby(SETTING, sort=False):
        _, task, _, level = setting
        drivers = attainable.stored().get(attainable.place(task, level, TRAFFIC), {}).get("drivers", {})
        low, high = attainable.ends(drivers)
        if not low < high:
            continue
        got, crashed = float(there["return"].mean()), float(there["crashed"].mean())
        score = (got - low) / (high - low)
        fair = {name: one for name, one in drivers.items() if one["kind"] != MORE}
        rules = {
            name: one["return"]
            for name, one in fair.items()
            if one["kind"] == CONSTANT or (name in MAKERS and name not in FORESEEING)
        }
        best = max(rules, key=rules.__getitem__)
        spotless = any(one["kind"] == POLICY and one["crashed"] == 0.0 for one in fair.values())
        lacks = {"return": got < rules[best], "score": score < LEAST, "crashed": spotless and crashed > MOST}
        failed = " ".join(name for name, is_so in lacks.items() if is_so)
        values = [there["cell"].nunique(), got, score, crashed, best, rules[best], len(fair) < len(drivers)]
        rows.append([*setting, *values, not failed, failed])
    return in_order(pd.DataFrame(rows, columns=COLUMNS), "backend", "task", "level")


def competent(verdicts: pd.DataFrame) -> Places:
    """The settings whose control agents are competent."""
    rows = verdicts[verdicts["competent"].astype(bool)]
    return tuple(rows[["task", "level_name"]].itertuples(index=False, name=None))
