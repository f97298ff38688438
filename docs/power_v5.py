"""Power of plan 5, by the variances of the two frozen studies: ``python docs/power_v5.py``.

The ten effects have the standard errors of the second study at five agents an arm, for the lightest and densest setting
of each task that it has. The bounds on a pair have those of plan 4's pairs, weighed by the belief, each minus its own
agents: a new pair's are not known.
"""

from __future__ import annotations

import sys
from pathlib import Path

import pandas as pd
from scipy import stats

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from experiments.analysis import estimate
from experiments.analysis.effects import contrasts, means
from experiments.analysis.plan import ALPHA, STUDY
from experiments.analysis.scores import arms_of
from experiments.study.design.traffic import TRAFFICS
from experiments.study.results.loaded import SETTING
from experiments.study.results.schema import EPISODES
from experiments.study.results.store import Store

RESULTS = Path(__file__).resolve().parents[1] / "results"
SCENARIOS = 400
EFFECTS = (0.05, 0.10, 0.15)  # true differences in the crash rate
# Of a pair minus an agent: as shares of the margin.
SHARES = (0.0, 0.2, 0.4, 0.6)
DIVERGED = ("two-way", 200)  # pair of plan 4 whose control network diverged
ASKED = [("crashed", traffic) for traffic in ("risky", "regular")]


def episodes(study: str, kinds: dict[str, str]) -> pd.DataFrame:
    """Test episodes on the first scenarios, of the cells of these arms and their kinds."""
    rows, store = [], Store(RESULTS / study)
    for name, record in store.records().items():
        key, own = record["key"], store.tables(name)[EPISODES]
        if kinds.get(key["arm"]) == key["kind"] and {*own["traffic"]} == {*TRAFFICS}:
            about = {column: key[column] for column in (*SETTING, "arm", "seed")}
            rows.append(own[["traffic", "scenario", "crashed"]].assign(**about))
    found = pd.concat(rows, ignore_index=True).astype({"crashed": float})
    return found[found["scenario"] < found["scenario"].min() + SCENARIOS].reset_index(drop=True)


def of_effects() -> pd.DataFrame:
    """The ten effects [points]: standard errors, what 8 of 10 studies find at Holm's first and last step, and power."""
    drives = episodes("second", {"control": "agent", "treatment": "agent"})
    ends = drives[pd.Series(zip(drives["task"], drives["level_name"], strict=True)).isin(STUDY.stages["a"])]
    effects = contrasts(arms_of(ends, ["crashed"]), {("treatment", "control"): ASKED})
    found = means(effects, STUDY)
    rows = []
    for row in found[found["scope"].isin(STUDY.tasks)].itertuples():
        line = {"task": row.scope, "traffic": row.term, "settings": row.settings}
        line |= {"se": 100 * row.se, "df": row.df}
        for step, alpha in (("first", ALPHA / 10), ("last", ALPHA)):
            line[f"{step} step"] = 100 * estimate.detectable(row.se, row.df, alpha)
            limit = stats.t.ppf(1 - alpha / 2, row.df)
            line |= {
                f"at {100 * d:.0f}": stats.nct.sf(limit, row.df, d / row.se)
                for d in EFFECTS
                if step == "first"
            }
        rows.append(line)
    return pd.DataFrame(rows)


def of_bounds() -> pd.DataFrame:
    """The bounds on a pair over the tasks and by task: standard error, and the power at some true differences."""
    drives = episodes("pairs", {"control": "agent", "treatment": "agent", "belief": "test"})
    half = drives["seed"].max() + 1 - drives["seed"].min() >> 1
    treated = drives["arm"] == "treatment"
    drives = drives.assign(seed=drives["seed"] - half * treated)  # the pair's second agent
    drives = drives.replace({"arm": {"belief": "weighed"}})
    there = drives.groupby(["task", "seed"])["arm"].transform("nunique")
    drives, rows = drives[there == 3], []
    sound = drives[(drives["task"] != DIVERGED[0]) | (drives["seed"] != DIVERGED[1])]
    for name, kept in (("all pairs", drives), ("without the diverged one", sound)):
        for bound in STUDY.price[:2]:
            asked = {("weighed", bound.against): [("crashed", bound.term)]}
            for row in means(contrasts(arms_of(kept, ["crashed"]), asked), STUDY).itertuples():
                line = {"pairs": name, "traffic": bound.term, "scope": row.scope}
                line |= {"se": 100 * row.se, "df": row.df}
                limit = stats.t.ppf(1 - ALPHA, row.df)
                away = {share: (1 - share) * bound.margin / row.se for share in SHARES}
                rows.append(line | {f"at {d}": stats.nct.sf(limit, row.df, far) for d, far in away.items()})
    return pd.DataFrame(rows)


if __name__ == "__main__":
    for table in (of_effects(), of_bounds()):
        print(table.to_string(index=False, float_format="{:.2f}".format))
