"""From test episodes to the scores of each arm: its agents' outcomes on the scenarios that all of them met."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from experiments.analysis.plan import OUTCOMES, Outcome
from experiments.study.design import attainable
from experiments.study.design.cell import tested_on
from experiments.study.design.levels import is_usual, tasks_known
from experiments.study.design.sheet import task_of
from experiments.study.design.traffic import AT_A_DOSE, TRAFFICS
from experiments.study.results.loaded import AGENT, SETTING, Results
from experiments.support.errors import UserError
from sumo_env.tasks import TASKS


def in_order(rows: pd.DataFrame, *columns: str) -> pd.DataFrame:
    """The rows sorted by columns, tasks and traffics in the grid's order."""
    order = {"task": {task: number for number, task in enumerate(tasks_known())}, "traffic": AT_A_DOSE}

    def rank(column: pd.Series) -> pd.Series:
        return column.map(order[column.name]) if column.name in order else column

    return rows.sort_values(list(columns), key=rank, ignore_index=True, kind="stable")


def with_outcomes(results: Results, outcomes: Mapping[str, Outcome] = OUTCOMES) -> pd.DataFrame:
    """The test episodes with all outcomes as columns: those of the plan and the user's own.

    Columns more than in `results.episodes`: the names of the outcomes; seconds that the episode was to last, and
    progress: metres per second of them.
    """
    episodes = results.episodes

    def of_cell(value: Callable[[Mapping[str, Any]], Any]) -> pd.Series:
        return episodes["cell"].map({name: value(cell["key"]) for name, cell in results.cells.items()})

    lasted = episodes["length"] / of_cell(lambda key: key["env_config"].get("policy_frequency", 1))
    crashed = episodes["crashed"].astype(float)
    seconds = of_cell(
        lambda key: key["env_config"].get("duration", TASKS[task_of(key["task"])].defaults["duration"])
    )
    scores = attainable.scores(episodes).where(of_cell(is_marked))
    own = {name: outcome.of for name, outcome in outcomes.items() if outcome.of is not None}
    return episodes.assign(
        **own,
        seconds=seconds.astype(float),
        progress=episodes["distance"] / seconds,
        crashed=crashed,
        score=scores,
        reward_per_step=episodes["return"] / episodes["length"],
        crash_free_time=episodes["crash_time"].astype(float).where(crashed > 0).fillna(lasted),
        crashes_per_100_km=1e5 * per_metre(episodes, "crashed", ["cell", "traffic"]),
    )


def is_marked(key: Mapping[str, Any]) -> bool:
    """Whether a cell is tested as those who mark its returns were driven: on SUMO, and as the task is configured."""
    backend, _, config = tested_on(key)
    return backend == "sumo" and is_usual(backend, key["task"], key["level"], config)


def undrivable(results: Results) -> list[str]:
    """The settings, with nothing else configured, that cannot be driven (`design.attainable`): "two-way 15+6"."""
    keys = [cell["key"] for cell in results.cells.values()]
    there = {
        f"{key['task']} {key['level_name']}"
        for key in keys
        if is_usual(key["backend"], key["task"], key["level"], key["env_config"])
    }
    return [setting for setting in attainable.undrivable(attainable.stored()) if setting in there]


def per_metre(episodes: pd.DataFrame, count: str, by: Sequence[str]) -> pd.Series:
    """The ratio of sums of a column and the distance in each group of `by`, linearised: its mean over a group's
    episodes is the ratio [1/m], and their spread gives its standard error. 0 where nobody moves.
    """
    counted = episodes[count].astype(float)
    grouped = episodes.assign(counted=counted).groupby([*by], sort=False)
    way, number = grouped["distance"].transform("mean"), grouped["counted"].transform("mean")
    rate = number / way
    return (rate + (counted - rate * episodes["distance"]) / way).where(way > 0, 0.0)


def at_home(episodes: pd.DataFrame) -> pd.DataFrame:
    """The episodes of tests on the simulator of the training."""
    return episodes[episodes["tested_on"] == episodes["backend"]]


def once_each(episodes: pd.DataFrame) -> pd.DataFrame:
    """The episodes; UserError where an agent has one twice, so that cells of two versions would be averaged."""
    names = [*AGENT, "traffic", "scenario"]
    twice = episodes[episodes.duplicated(names, keep=False)]
    for _, same in twice.groupby(names, dropna=False, sort=False):
        raise UserError(
            f"{' and '.join(same['cell'])} both test one agent in {same['traffic'].iloc[0]} traffic, in scenario "
            f"{same['scenario'].iloc[0]}: move one of them out of the folder"
        )
    return episodes


Setting = tuple[str, str, int, str]  # backend, task, level, level_name
# The agents of an arm in a setting: of each outcome an array (traffic, agent, scenario).
Arm = Mapping[str, NDArray[np.float64]]
Arms = Mapping[str, Arm]  # by name


def arms_of(
    episodes: pd.DataFrame, outcomes: Iterable[str] = tuple(OUTCOMES), traffics: Sequence[str] = TRAFFICS
) -> dict[Setting, dict[str, Arm]]:
    """The scores of all outcomes by setting and arm, in the grid's order.

    Args:
        episodes: as from `with_outcomes`, of agents that all met the same scenarios; the arm's name is in "arm".
        outcomes: those that a setting does not have (NaN) are left out. traffics: of the arrays, in the grid's order.

    Raises:
        UserError: an agent has an episode twice.
    """
    rows = once_each(episodes[episodes["traffic"].isin(list(traffics))])
    rows = in_order(rows, "backend", "task", "level", "arm", "traffic", "seed", "scenario")
    there = [name for name in outcomes if name in rows]
    result: dict[Setting, dict[str, Arm]] = {}
    for (*setting, arm), group in rows.groupby([*SETTING, "arm"], sort=False):
        shape = (len(traffics), group["seed"].nunique(), -1)
        known = group[there].notna().all()
        values = {
            name: group[name].to_numpy(dtype=np.float64).reshape(shape) for name in there if known[name]
        }
        result.setdefault((setting[0], setting[1], setting[2], setting[3]), {})[str(arm)] = values
    return result
