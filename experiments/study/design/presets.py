"""Named sizes of the experiment. A command line changes what a preset sets; the cells say what was used."""

from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Any, TypeVar

from experiments.backends import MakeEnv, make_env
from experiments.study.design.cell import Cell
from experiments.study.design.experiment import Dynamics, Experiment
from experiments.study.design.fingerprint import dynamics
from experiments.study.design.sheet import GRID, Sheet
from experiments.study.design.traffic import UNSEEN
from experiments.support.errors import UserError, check_known
from sumo_env.config import MEASURED
from sumo_env.spaces.approach import APPROACH

E = TypeVar("E", bound=Experiment)

# Training episodes of an agent in the paper. Budgets are counted in updates, equal for both arms: the number of
# target copies sets how far an agent looks ahead, and with it its appetite for risk, while equal numbers of episodes
# would give the arms different numbers of updates.
PAPER_EPISODES = 3072
# The paper's numbers, over the defaults of `agents.dqn.DQNConfig`; where it is silent, those of the code that it cites,
# except the target network, which that code copies at every update: at gamma .99 six of six agents diverged
# (docs/developers/decisions.md).
PAPER = {
    "network": "dueling",
    "gamma": 0.99,
    "learning_rate_final": 5e-4,
    "n_steps": 1,
    "steps_per_update": 1,
    "batch_size": 100,
    "clip_goals": False,
    "target_interval": 500,
    "tau": 1.0,
    "warm_up": 100,
    "standardise": False,
    "by_hand": False,
}
# The settings of the study: the levels of each task, without two-way 15+6, which cannot be driven (`attainable`). The
# two-way road is studied under two ladders of target speeds.
SETTINGS = {
    **{task: tuple(range(1, len(names) + 1)) for task, names in GRID.items()},
    "two-way": (1, 2),
    "two-way-brakes": (1,),
}


def tuned(own: Sheet, updates: int, **settings: Any) -> dict[str, Any]:
    """The profile "tuned" of a task: the defaults of `agents.dqn.DQNConfig`, but for these.

    The target network moves equally far in a step of the environment everywhere. Training episodes may have a longer
    clock than the test's, of which the share that is over is observed in both (see `wrappers`).
    """
    longer = {"training_clock": [own.clock, own.clock], "time_observed": own.clock} if own.clock else {}
    often = {"steps_per_update": own.steps_per_update, "tau": 0.00125 * own.steps_per_update}
    return {"updates": updates, **often, "batch_size": own.batch_size, **longer, **settings}


PRESETS = {
    experiment.preset: experiment
    for experiment in (
        Experiment(
            preset="smoke",
            about="all five tasks, a minute: proves that everything runs, answers nothing",
            levels=(1,),
            seeds=1,
            episodes=4,
            gate_episodes=4,
            learners=lambda own: tuned(own, 400, warm_up=200),
            features=APPROACH,
        ),
        Experiment(
            preset="quick",
            about="all five tasks in their lightest traffic, three seeds an arm: 10 to 20 minutes on two cores",
            levels=(1,),
            seeds=3,
            episodes=50,
            gate_episodes=100,
            learners=lambda own: tuned(own, own.quick_updates),
            features=APPROACH,
        ),
        Experiment(
            preset="study",
            about="the study (docs/developers/plan_v6.md): 18 settings, five seeds, 400 scenarios",
            levels_of=SETTINGS,
            seeds=5,
            episodes=400,
            gate_episodes=100,
            learners=lambda own: tuned(own, own.updates),
            features=APPROACH,
            first_seed=800,
            first_scenario=8000,
            test_on=("replica",),
            lightest=("only-parameters", MEASURED),
            further_episodes=200,
            drivers=("planner", "sumo"),
        ),
        Experiment(
            preset="paper",
            about="the paper's 18 settings with its own learner, 3072 episodes' worth of updates: many hours",
            seeds=10,
            episodes=100,
            gate_episodes=100,
            learners=lambda own: {"updates": PAPER_EPISODES * own.episode_length, **PAPER},
        ),
    )
}


def of_preset(kind: type[E], preset: str = "quick", **changes: Any) -> E:
    """A preset as an experiment, or as the options of a command, with changes. Raises UserError for an unknown one."""
    check_known("preset", [preset], PRESETS)
    return kind(**{**vars(PRESETS[preset]), **changes})


def asked_preset(words: Sequence[str]) -> str:
    """The preset that a command line names, by default quick."""
    named = [value for option, value in pairwise(words) if option == "--preset"]
    return named[-1] if named else "quick"


def cells_of(asked: Experiment, dynamics: Dynamics = dynamics, make_env: MakeEnv = make_env) -> list[Cell]:
    """All cells of an experiment. Raises UserError where something does not exist, or asks for nothing."""
    cells = asked.cells(dynamics, make_env)
    for option, is_answered in _answers(asked, cells):
        if not is_answered:
            raise UserError(f"{option} asks for nothing here: leave it out")
    return cells


def _answers(asked: Experiment, cells: Sequence[Cell]) -> Iterator[tuple[str, bool]]:
    """What is asked beyond the preset, and whether there is a cell of it."""
    usual, tests = PRESETS.get(asked.preset), [cell for cell in cells if cell.kind == "test"]

    def named(option: str) -> Sequence[str]:
        names: tuple[str, ...] = getattr(asked, option)
        return () if usual and names == getattr(usual, option) else names

    for task in named("tasks"):
        yield f"--tasks {task}", any(cell.task == task for cell in cells)
    for name in named("test_on"):
        yield f"--test-on {name}", any(cell.runs_on == name != cell.backend for cell in tests)
    for name in named("drivers"):
        yield f"--drivers {name}", any(cell.policy == name for cell in cells)
    for name in named("traffics"):
        of_agents = (cell for cell in tests if cell.runs_on == cell.backend)
        yield f"--traffics {name}", any(name in cell.tested["traffics"] for cell in of_agents)
    if asked.unseen:
        yield "--unseen", any(set(cell.tested["traffics"]) <= set(UNSEEN) for cell in tests)
