"""Two drivers from equal critical moments: who gets into danger, and who gets out of it (docs/takeover.md).

One driver leads. After each of its steps a copy of the episode, which meets the same future, goes on with IDLE: target
speed and lane stay as the leader left them. The moment is critical where that copy crashes within a bound, because then
the driver has to act. From the leader's first critical moment every driver goes on in a copy of its own.
"""

import copy
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import gymnasium as gym

from agents.rules import DRIVERS
from experiments.backends import make_env
from experiments.study.compute import batches
from experiments.study.compute.entrants import Entrant
from experiments.study.compute.evaluate import repeat
from experiments.study.compute.wrappers import UnseenRisk
from experiments.study.design.arms import scenario_seed, stream_seed
from experiments.study.design.levels import level_names
from experiments.study.design.sheet import task_of
from experiments.study.design.traffic import traffic_named

PAIR = ("a", "b")  # the two drivers that are compared, in the columns of the record
OTHERS = ("planner", "sumo", "slower", "random")  # who may take over beside them
COSTLY = ("planner",)  # who takes over from the first pair's moments alone
BOUNDS = (3.0,)  # [s] within which IDLE crashes at a critical moment
WINDOW = 5.0  # [s] after the moment in which crashes count
# Columns of the record, with their types: a row a pair, leader, scenario and bound.
COLUMNS: dict[str, str] = {
    **dict.fromkeys(("task", "level", "traffic"), "str"),
    "pair": "int64",  # its number, from 0 on
    "leader": "str",  # of PAIR
    "scenario": "int64",  # number of the test scenario
    "within": "float64",  # [s] the bound
    "moment": "float64",  # [s] since the reset; missing where there is no critical moment
    "speed": "float64",  # [m/s] at the moment
    "km": "float64",  # that the leader drove, up to the moment or the end
    "sudden": "bool",  # whether the leader crashed without a critical moment before
    # [s] from the moment until each driver crashes: inf if it does not (OTHERS: in WINDOW), missing if it did not drive
    **{f"crash_{name}": "float64" for name in (*PAIR, *OTHERS)},
    "actions": "str",  # that the leader has taken before the moment, a digit each
}
Env = gym.Env[Any, Any]


class Moment(NamedTuple):
    """An episode up to a moment, from which drivers can go on.

    env: stands there. past: results of the reset and of each step. actions: of the steps. km: driven.
    """

    env: Env
    past: list[Any]
    actions: list[int]
    km: float


class Seat(gym.Wrapper[Any, Any, Any, Any]):
    """Shows its driver an episode, whoever drives it; the driver's own wrappers lie around it."""

    given: Any = None  # the last result of the episode

    def reset(self, **_: Any) -> Any:
        """What the episode began with."""
        return self.given

    def step(self, action: Any) -> Any:
        """What the step has brought."""
        return self.given


class Driver:
    """An entrant, who is shown all of an episode in order, so that memory, clock and draws of its own go on.

    Those of `agents.rules.DRIVERS` drive the environment that they were made for: they only take over, and are made
    anew for the copy.

    Raises:
        UserError: it does not fit the environment.
    """

    def __init__(self, entrant: Entrant, env: Env) -> None:
        self.leads = entrant.name not in DRIVERS
        self._entrant = entrant
        self._make(env)

    def _make(self, env: Env) -> None:
        self._seat = Seat(env)
        self._seen, self._policy = self._entrant.make(self._seat)

    def begin(self, env: Env, first: Any, seed: int) -> None:
        """Be shown the first result of an episode. seed: of the driver's own draws."""
        if not self.leads:
            self._make(env)
        self._seat.env, self._seat.given = env, first
        self._policy.reset(seed)
        self._observation, _ = self._seen.reset()

    def act(self) -> int:
        """The action for what it was shown last."""
        return int(self._policy.act(self._observation))

    def watch(self, action: int, result: Any) -> None:
        """Be shown a step: the action that was driven, and its result."""
        self._seat.given = result
        self._observation = self._seen.step(action)[0]

    def go_on(
        self,
        moment: Moment,
        seed: int,
        seconds: float = math.inf,
        on_step: Callable[[], None] = lambda: None,
    ) -> float:
        """Take over at a moment, in its environment, for so many seconds or to the end.

        Returns:
            The time until it crashes [s], inf where it does not.
        """
        env, (first, *others) = moment.env, moment.past
        if self.leads:
            self.begin(env, first, seed)
            for action, result in zip(moment.actions, others, strict=True):
                self.act()  # which is not driven
                self.watch(action, result)
        else:
            now = moment.past[-1]
            self.begin(env, (now[0], now[-1]), seed)
        for step in range(1, steps_in(env, seconds) + 1):
            action = self.act()
            result = env.step(action)
            on_step()
            if result[-1]["crashed"]:
                return step / steps_in(env)
            if result[2] or result[3]:
                break
            self.watch(action, result)
        return math.inf


def steps_in(env: Env, seconds: float = 1.0) -> int:
    """Policy steps in so many seconds, at most in an episode's."""
    config: Mapping[str, Any] = env.unwrapped.config  # type: ignore[attr-defined]
    return round(min(seconds, config["duration"]) * config["policy_frequency"])


def time_to_crash(env: Env, action: int, seconds: float) -> float:
    """How long a copy that repeats an action drives until it crashes [s]; inf where it does not in so many seconds."""
    with closing(copy.deepcopy(env)) as twin:
        taken, crashed, _ = repeat(twin, action, steps_in(env, seconds))
    return len(taken) / steps_in(env) if crashed else math.inf


def lead(
    env: Env, driver: Driver, reset: Mapping[str, Any], seed: int, bounds: Sequence[float]
) -> tuple[dict[float, Moment], Moment]:
    """Drive an episode until there was a first critical moment for each bound, or to its end.

    Args:
        reset: arguments of `env.reset`. seed: of the driver's own draws.

    Returns:
        The moments by bound, and where the leader stopped.
    """
    inner: Any = env.unwrapped
    [idle] = [number for number, name in inner.actions.items() if name == "IDLE"]
    here, moments, over = Moment(inner, [env.reset(**reset)], [], 0.0), dict[float, Moment](), False
    driver.begin(env, here.past[0], seed)
    while not over:
        action = driver.act()
        result: Any = env.step(action)
        driver.watch(action, result)
        _, _, terminated, truncated, info = result
        km, over = here.km + info["distance"] / 1000.0, terminated or truncated
        here = Moment(inner, [*here.past, result], [*here.actions, action], km)
        if not over:
            missing = [bound for bound in bounds if bound not in moments]
            doom = time_to_crash(inner, idle, max(missing))
            if found := [bound for bound in missing if doom <= bound]:
                moments |= dict.fromkeys(found, here._replace(env=copy.deepcopy(inner)))
                over = len(moments) == len(bounds)
    return moments, here


def compared(
    env: Env,
    drivers: Mapping[str, Driver],
    leader: str,
    reset: Mapping[str, Any],
    seed: int,
    bounds: Sequence[float] = BOUNDS,
) -> Iterator[dict[str, Any]]:
    """One episode, and how each driver goes on from its critical moments: a row for each bound [s], as of COLUMNS.

    Args:
        drivers: by their names in COLUMNS. leader: one of them.
        reset: arguments of `env.reset`. seed: of all drivers' own draws.
    """
    moments, end = lead(env, drivers[leader], reset, seed, bounds)
    endings = {key: _endings(drivers, one, seed) for key, one in {id(m): m for m in moments.values()}.items()}
    for bound in bounds:
        row: dict[str, Any] = {"leader": leader, "within": bound}
        if (moment := moments.get(bound)) is None:
            yield {**row, "km": end.km, "sudden": bool(end.past[-1][-1]["crashed"]), "actions": ""}
            continue
        yield {
            **row,
            **endings[id(moment)],
            "moment": len(moment.actions) / steps_in(env),
            "speed": moment.past[-1][-1]["speed"],
            "km": moment.km,
            "sudden": False,
            "actions": "".join(map(str, moment.actions)),
        }


def _endings(drivers: Mapping[str, Driver], moment: Moment, seed: int) -> dict[str, float]:
    """When each driver crashes that goes on in a copy; the moment's own environment is closed."""
    found = {}
    with closing(moment.env) as there:
        for name, driver in drivers.items():
            with closing(copy.deepcopy(there)) as twin:
                seconds = math.inf if name in PAIR else WINDOW
                found[f"crash_{name}"] = driver.go_on(moment._replace(env=twin), seed, seconds)
    return found


@dataclass(frozen=True)
class Question:
    """What is driven, by whom.

    task: may be a variant (`sheet.VARIANTS`). config: of the environment, as from `levels.env_config`. traffic: by its
    name in `traffic.ALL`. drivers: by their names in COLUMNS, resolved. bounds: of critical moments [s]. dynamics: what
    the simulator does, see `fingerprint.dynamics`.
    """

    task: str
    level: str
    config: Mapping[str, Any]
    traffic: str
    drivers: Mapping[str, Entrant]
    bounds: tuple[float, ...]
    dynamics: str

    @property
    def key(self) -> dict[str, Any]:
        """All that decides the result, as plain values."""
        return vars(self) | {"drivers": {name: [one.name, one.digest] for name, one in self.drivers.items()}}

    @property
    def leaders(self) -> list[str]:
        """Those of PAIR who can lead."""
        return [name for name in PAIR if self.drivers[name].name not in DRIVERS]

    def open(self, render_mode: str | None = None, **view: Any) -> Env:
        """An environment of the task and traffic."""
        env = make_env("sumo", task_of(self.task), {**self.config, **view}, render_mode)
        traffic = traffic_named(self.traffic)
        return UnseenRisk(env, traffic) if traffic.is_unseen else env

    def reset(self, scenario: int) -> dict[str, Any]:
        """Arguments of the reset that begins a test scenario of the study."""
        seed = scenario_seed(self.task, level_names(self.task).index(self.level) + 1, scenario)
        return {"seed": seed, "options": traffic_named(self.traffic).options(seed)}

    def seed(self, scenario: int) -> int:
        """Of the drivers' own draws: the same for all, so that a driver against itself differs in nothing."""
        return stream_seed("takeover", self.task, self.level, self.traffic, scenario)


@dataclass(frozen=True)
class Batch(batches.Batch):
    """Some scenarios, led by each of two drivers in turn. pair: their number. first, count: scenarios."""

    question: Question
    pair: int
    first: int
    count: int
    columns = COLUMNS

    @cached_property
    def name(self) -> str:
        """By traffic, pair and first scenario."""
        key = {**self.question.key, "count": self.count}
        return batches.named(f"{self.question.traffic}-{self.pair}-{self.first:04d}", key)

    @property
    def each(self) -> list[tuple[int, str]]:
        """Scenario and leader of each episode."""
        numbers = range(self.first, self.first + self.count)
        return [(number, leader) for number in numbers for leader in self.question.leaders]

    @property
    def episodes(self) -> dict[str, list[Any]]:
        """Scenario, leader and bound of each row."""
        rows = [(*episode, bound) for episode in self.each for bound in self.question.bounds]
        return {name: [row[k] for row in rows] for k, name in enumerate(("scenario", "leader", "within"))}

    def drive(self) -> Iterator[dict[str, Any]]:
        """Drive them."""
        asked = self.question
        about = {"task": asked.task, "level": asked.level, "traffic": asked.traffic, "pair": self.pair}
        with closing(asked.open()) as env:
            drivers = {name: Driver(entrant, env) for name, entrant in asked.drivers.items()}
            for scenario, leader in self.each:
                reset, seed = asked.reset(scenario), asked.seed(scenario)
                for row in compared(env, drivers, leader, reset, seed, asked.bounds):
                    yield {**about, "scenario": scenario, **row}
