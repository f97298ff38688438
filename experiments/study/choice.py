"""Choose the second version of the profile "tuned": train its variants and compare their returns.

    python -m experiments.study.choice --out DIR           train what is missing, block by block
    python -m experiments.study.choice --out DIR --check   the same for the chosen learner on all five tasks
    python -m experiments.study.choice --out DIR --pack    add what is there to results/choice, and judge it

Design, rule and outcome: docs/developers/learner_choice.md. The same command goes on where it was stopped; several
of them on one folder share the work.
"""

from __future__ import annotations

import os
import shutil
import time
from collections.abc import Iterable, Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import tyro

from experiments.backends import make_env
from experiments.study.arms import ARMS
from experiments.study.evaluate import evaluate
from experiments.study.experiment import Experiment
from experiments.study.grid import Cell, env_config
from experiments.study.presets import PRESETS, second_version
from experiments.study.run import locked
from sumo_env.tasks import TASKS as DRIVEN

if TYPE_CHECKING:
    import pandas as pd

PACKED = Path(__file__).resolve().parents[2] / "results" / "choice" / "runs.parquet"
TASKS = ("u-turn", "two-way")  # in their lightest traffic
STEPS = {"u-turn": 40_000, "two-way": 80_000}  # environment steps of the first version
RANGE = {task: env_config("sumo", task, 1)["duration"] for task in DRIVEN}  # of the return: one a second
SEEDS = (900, 901, 902)  # no report uses these
CHECK_SEED = 905  # nor this one
EPISODES, PURPOSE = 100, "choice"  # scenarios of their own, see `arms.scenario_seed`
MARK = 3 / 4  # of the budget: what the last quarter changes
TOLERANCE = 0.02  # of the return's range

LEARNERS = {  # environment steps per update, batch
    "quarter-100": (4, 100),  # the first version's
    "quarter-256": (4, 256),
    "half-128": (2, 128),
    "one-64": (1, 64),
}
VARIANTS = {  # name -> settings
    task: {name: second_version(task, STEPS[task], *learner) for name, learner in LEARNERS.items()}
    for task in TASKS
}
VARIANTS["u-turn"]["half-128-longer"] = second_version(
    "u-turn", STEPS["u-turn"], *LEARNERS["half-128"], clock="longer"
)

# Other clocks for the chosen learner: a time that nobody observes, and the first version's.
CLOCKS: list[tuple[str, str, dict[str, Any]]] = [
    ("second-no-time", "roundabout", {"training_clock": [15, 15]}),
    ("second-first-clock", "roundabout", {"finite_horizon": True}),
    ("second-no-time", "u-turn", {"training_clock": [13, 13]}),
]


def cells() -> Iterator[tuple[str, Cell]]:
    """Every variant's name and training, in the order of computation: by seed, task, variant and arm."""
    for seed in SEEDS:
        for task in TASKS:
            for name, variant in VARIANTS[task].items():
                asked = Experiment(
                    preset=name,
                    tasks=(task,),
                    levels=(1,),
                    seeds=1,
                    episodes=EPISODES,
                    learners={task: variant},
                    first_seed=seed,
                )
                yield from ((name, cell) for cell in asked.cells() if cell.kind == "agent")


def chosen() -> Iterator[tuple[str, Cell]]:
    """The chosen learner's name and training in both arms of all five tasks, the longest first, then with CLOCKS."""
    preset = PRESETS["second"]
    check = replace(
        preset,
        levels=(1,),
        seeds=1,
        episodes=EPISODES,
        gate_episodes=None,
        first_seed=CHECK_SEED,
        first_scenario=0,
    )
    profiles = {task: preset.profile(task) for task in RANGE}
    runs = [
        (preset.preset, task, profiles[task]) for task in sorted(RANGE, key=lambda t: -profiles[t]["updates"])
    ]
    for name, task, clock in CLOCKS:
        others = {k: v for k, v in profiles[task].items() if k not in ("training_clock", "time_observed")}
        runs.append((name, task, {**others, **clock}))
    for name, task, profile in runs:
        asked = replace(check, preset=name, tasks=(task,), learners={task: profile})
        yield from ((name, cell) for cell in asked.cells() if cell.kind == "agent")


def compute(name: str, cell: Cell, folder: Path) -> pd.DataFrame:
    """Train an agent and test it in the traffic of its own arm, at MARK and at the end; one row an episode."""
    import pandas as pd

    from experiments.study.policies import load_agent
    from experiments.study.train import train_cell

    assert cell.arm is not None
    started = time.process_time()
    with closing(make_env(cell.backend, cell.task, cell.training_config)) as env:
        trained = train_cell(cell, env, folder, marks=(MARK,))
    with closing(make_env(cell.backend, cell.task, dict(cell.env_config))) as env:
        seen, early = load_agent(cell.key(), None, trained.marks[0], env)
        (own,) = cell.gate_traffics
        tables = [
            evaluate(seen, policy, cell.task, 1, EPISODES, purpose=PURPOSE, traffics=(own,)).assign(
                share=share
            )
            for share, policy in ((MARK, early), (1.0, trained.policy))
        ]
    learner = trained.learner
    largest = max(row[2] if row[2] is not None else float("inf") for row in learner["probe_q"])
    return pd.concat(tables, ignore_index=True).assign(
        task=cell.task,
        variant=name,
        arm=cell.arm,
        seed=cell.seed,
        cell=cell.name,
        largest_q=largest,
        q_bound=learner["q_bound"],
        weights=learner["weights_sha256"],
        cpu_seconds=time.process_time() - started,
    )


def train_all(runs: Iterable[tuple[str, Cell]], out: Path) -> None:
    """Compute every one of the runs that is not there; says what it does."""
    import pandas as pd

    known = set(pd.read_parquet(PACKED, columns=["cell"])["cell"]) if PACKED.exists() else set()
    for name, cell in runs:
        label = f"{cell.task} {name} {cell.arm} {cell.seed}"
        path, scratch = out / f"{label.replace(' ', '_')}.parquet", out / "work" / cell.name
        if path.exists() or cell.name in known:
            continue
        with locked(scratch) as mine:
            if not mine or path.exists():
                continue
            print(time.strftime("%H:%M:%S"), label, flush=True)
            table = compute(name, cell, scratch)
            table.to_parquet(temporary := path.with_suffix(".tmp"), index=False)
            os.replace(temporary, path)
            shutil.rmtree(scratch)
            print(time.strftime("%H:%M:%S"), f"{table['cpu_seconds'].iloc[0]:.0f} s", flush=True)


def judge(table: pd.DataFrame) -> pd.DataFrame:
    """Of each task and variant: seeds, return and its change over the last quarter in units of the range, per arm.

    `score`, the mean of the arms' returns, is what the rule looks at. Crashes are not looked at.
    """
    share = table.assign(value=table["return"] / table["task"].map(RANGE))
    runs = share.pivot_table(index=["task", "variant", "arm", "seed"], columns="share", values="value")
    means = (
        runs.assign(change=runs[1.0] - runs[MARK]).groupby(["task", "variant", "arm"]).mean().unstack("arm")
    )
    result = means[[1.0, "change"]].rename(columns={1.0: "return"}, level=0)
    result.columns = [f"{what}_{arm}" for what, arm in result.columns]
    result["score"] = result[[f"return_{arm}" for arm in ARMS if f"return_{arm}" in result]].mean(
        axis=1, skipna=False
    )
    counts = runs.groupby(["task", "variant", "arm"]).size().unstack("arm")
    return result.assign(seeds=counts.fillna(0).min(axis=1)).sort_values(
        ["task", "score"], ascending=[True, False]
    )


def main(out: Path, check: bool = False, pack: bool = False) -> None:
    """Train the variants of the learner that are not there yet, or pack and judge those that are.

    Args:
        out: folder of the runs.
        check: train the chosen learner on all five tasks instead of the variants.
        pack: add its finished runs to results/choice/runs.parquet and judge them all; nothing is trained then.
    """
    import pandas as pd

    out.mkdir(parents=True, exist_ok=True)
    if not pack:
        train_all(chosen() if check else cells(), out)
        return
    files = [path for path in (PACKED, *sorted(out.glob("*.parquet"))) if path.exists()]
    runs = pd.concat(map(pd.read_parquet, files), ignore_index=True)
    runs = runs.drop_duplicates(["cell", "share", "scenario"])
    PACKED.parent.mkdir(parents=True, exist_ok=True)
    runs.to_parquet(PACKED, index=False, compression="zstd")
    print(judge(runs).round(4).to_string())


if __name__ == "__main__":
    tyro.cli(main)
