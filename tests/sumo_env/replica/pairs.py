"""Episodes of the replica beside highway-env itself, step by step: from the same scenario, or from the same seed."""

from collections.abc import Callable, Iterable, Iterator
from itertools import product
from typing import Any, NamedTuple

import highway_env  # noqa: F401  (registers its environments)
import numpy as np
import pytest

from agents.rules import POLICIES, make_policy
from experiments.backends import make_env
from sumo_env.tasks import TASKS
from tests.sumo_env.rollout import leaves

POSES = 1e-6  # [m], [m/s], [rad] by which poses and speeds may differ
VALUES = 1e-5  # by which observations (32 bits), rewards and measures may differ
EQUAL = 1e-6  # by which observations and rewards may differ of highway-env as it is installed
# highway-env's steering is unstable below this speed: a rounding error, which another processor makes elsewhere, grows
# sevenfold in every sub-step. From the first vehicle that is slower on, headings agree to SLOW_EQUAL.
SLOW, SLOW_EQUAL = 0.7, 1e-3  # [m/s], largest difference


class Case(NamedTuple):
    """One episode; `level`: name of the task's traffic level, `ego`: of a policy in `agents.rules`, `law`: of risk."""

    task: str
    variant: str
    level: str
    risk: float
    ego: str
    seed: int
    law: str = "standard"


def cases(task: str, count: int, seed: int = 0) -> list[Case]:
    """This many episodes, spread evenly over variants, levels, doses of risk and egos."""
    joined = task not in ("highway", "two-way")  # the variants differ at the ends of lanes alone
    variants = ("path", "connected", "v0") if joined else ("path",)
    every = list(product(variants, TASKS[task].levels, (0.0, 1.0), POLICIES))
    order = np.random.default_rng(seed).permutation(len(every)).tolist()
    chosen = [every[order[k % len(every)]] for k in range(count)]
    return [
        Case(task, variant, level, risk, ego, 1000 * seed + k)
        for k, (variant, level, risk, ego) in enumerate(chosen)
    ]


def side_by_side(
    stock: Any, replica: Any, act: Callable[[np.ndarray], int], **reset: int
) -> Iterator[tuple[Any, Any]]:
    """What `reset` and every `step` of an episode return in both, by the actions of highway-env's observations."""
    theirs, ours = stock.reset(**reset), replica.reset(**reset)
    yield theirs, ours
    over = False
    while not over:
        action = act(theirs[0])
        theirs, ours = stock.step(action), replica.step(action)
        yield theirs, ours
        over = theirs[2] or theirs[3]


# -- the same scenario -------------------------------------------------------------------------------------


def compare(case: Case) -> str:
    """What differs first in an episode, driven by the ego's policy; empty if it is the same."""
    config = {"risk": case.risk, "variant": case.variant, "risk_law": case.law}
    config |= TASKS[case.task].levels[case.level]
    stock, replica = (make_env(backend, case.task, config) for backend in ("highway-env", "replica"))
    policy = make_policy(case.ego, stock)
    policy.reset(case.seed)
    for step, results in enumerate(side_by_side(stock, replica, policy.act, seed=case.seed)):
        scenes = stock.get_wrapper_attr("scene"), replica.get_wrapper_attr("scene")
        if found := difference_of_scenes(*scenes) or first_difference(*results):
            return f"step {step}: {found}"
    return ""


def difference_of_scenes(theirs: Any, ours: Any) -> str:
    """Which vehicles there are, where and how fast."""
    if theirs.ids != ours.ids or not np.array_equal(theirs.crashed, ours.crashed) or theirs.time != ours.time:
        return "vehicles or wrecks"
    names = "x", "y", "speed", "heading"
    gaps = {name: abs(getattr(theirs, name) - getattr(ours, name)).max() for name in names}
    return "" if max(gaps.values()) <= POSES else f"{gaps}"


def first_difference(theirs: Any, ours: Any) -> str:
    """What `reset` or `step` returned differently: observation, reward, endings, or an entry of ``info``."""
    if not has_same_rows(theirs[0], ours[0]):
        return f"observation: {theirs[0]} and {ours[0]}"
    a, b = (dict(leaves(list(result[1:]))) for result in (theirs, ours))
    every = a.keys() | b.keys()
    wrong = [where for where in every if a.get(where) != pytest.approx(b.get(where), abs=VALUES)]
    return ", ".join(f"{where}: {a.get(where)} and {b.get(where)}" for where in wrong)


def has_same_rows(theirs: np.ndarray, ours: np.ndarray) -> bool:
    """Are two observations equal but for the order of their rows?

    Vehicles are sorted by their distance projected on the ego's lane. Those that stand one behind the other across that
    lane are equally far, up to rounding, and `sumo_env.spaces.observation` rounds by its own geometry.
    """
    left = list(ours)
    for row in theirs:
        same = [k for k, other in enumerate(left) if np.allclose(row, other, rtol=0.0, atol=VALUES)]
        if not same:
            return False
        left.pop(same[0])
    return True


# -- the same seed -----------------------------------------------------------------------------------------


def different(stock: Any, replica: Any, seeds: Iterable[int], *how: Any) -> list[tuple[int, str]]:
    """The episodes that are not those of highway-env as it is installed: seed, and what differs; how: as `episode`."""
    found = [(seed, episode(stock, replica, seed, *how)) for seed in seeds]
    return [entry for entry in found if entry[1]]


def episode(
    stock: Any, replica: Any, seed: int, act: Callable[..., Any] | None = None, slow: float = SLOW_EQUAL
) -> str:
    """What differed under random actions; every third episode continues the stream of the one before it.

    act: draws an action from highway-env's environment and a generator; `slow`: equality below the speed SLOW.
    """
    reset = {} if seed % 3 == 2 else {"seed": seed}
    rng, equal = np.random.default_rng(seed), EQUAL
    draw = act or (lambda env, rng: int(rng.integers(env.action_space.n)))
    results = side_by_side(stock, replica, lambda _: draw(stock.unwrapped, rng), **reset)
    for step, (theirs, ours) in enumerate(results):
        if min(abs(vehicle.speed) for vehicle in stock.unwrapped.road.vehicles) < SLOW:
            equal = slow
        states = [env.unwrapped.np_random.bit_generator.state for env in (stock, replica)]
        cars = [env.unwrapped.vehicle for env in (stock, replica)]
        there, here = ((*car.position, car.speed, car.heading) for car in cars)
        same = {
            "type of observation": theirs[0].dtype == ours[0].dtype,
            "observation": ours[0] == pytest.approx(theirs[0], abs=equal),
            "reward or end": ours[1:-1] == pytest.approx(theirs[1:-1], abs=equal),
            "ego": here == pytest.approx(there, abs=equal),
            "random stream": states[0] == states[1],
        }
        if not all(same.values()):
            return f"step {step}: {', '.join(what for what, is_same in same.items() if not is_same)}"
    return ""
