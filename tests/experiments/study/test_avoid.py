"""The search for actions without a contact finds one exactly where there is one."""

import itertools
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from agents.rules.constant import Constant
from experiments.backends import make_env
from experiments.study.compute.evaluate import Drive, play
from experiments.study.design.arms import scenario_seed
from experiments.study.replaying.avoid import REST, rewound, way_out
from experiments.study.replaying.rerun import Case
from experiments.study.results.store import Store

NAMES = {0: "LANE_LEFT", 1: "IDLE", 2: "LANE_RIGHT", 3: "FASTER", 4: "SLOWER"}
MOVES = {0: (1, 0), 1: (0, 0), 2: (-1, 0), 3: (0, 1), 4: (0, -1)}  # of lane and speed


class Grid:
    """Three lanes, four speeds, a place each step: whoever is at one of `walls` (step, lane, place) crashes."""

    open = 0

    def __init__(self, walls: frozenset[tuple[int, int, int]], ends: int = 99, frequency: int = 1) -> None:
        self.walls, self.ends = walls, ends
        self.config = {"policy_frequency": frequency}
        self.actions = NAMES
        self.state = (0, 1, 1, 0)  # step, lane, speed, place

    def step(self, action: int) -> tuple[None, float, bool, bool, dict[str, bool]]:
        step, lane, speed, place = self.state
        sideways, faster = MOVES[action]
        lane, speed = min(max(lane + sideways, 0), 2), min(max(speed + faster, 0), 3)
        self.state = (step + 1, lane, speed, place + speed)
        crashed = (step + 1, lane, place + speed) in self.walls
        return None, 0.0, crashed, step + 1 >= self.ends, {"crashed": crashed}

    @property
    def vehicle(self) -> SimpleNamespace:
        _, lane, speed, place = self.state
        return SimpleNamespace(
            target_lane_index=lane,
            speed_index=speed,
            position=np.array([place, lane]),
            speed=speed,
            heading=0.0,
        )

    def __deepcopy__(self, memo: object) -> "Grid":
        twin = Grid(self.walls, self.ends, self.config["policy_frequency"])
        twin.state = self.state
        Grid.open += 1
        return twin

    def close(self) -> None:
        Grid.open -= 1


def survives(grid: Grid, actions: tuple[int, ...]) -> bool:
    """Whether there is no contact for these actions, or until the episode ends."""
    own = Grid(grid.walls, grid.ends)
    for action in actions:
        *_, crashed, over, _ = own.step(action)
        if crashed or over:
            return not crashed
    return True


BRAKING = frozenset({(1, 1, 0), (1, 0, 1), (1, 2, 1), (1, 1, 2), (2, 1, 2)})  # IDLE, then SLOWER alone
walls = st.frozensets(st.tuples(st.integers(1, 5), st.integers(0, 2), st.integers(0, 9)), max_size=120)


@settings(max_examples=60, deadline=None, derandomize=True)
@given(walls=walls, ends=st.integers(3, 7), horizon=st.integers(1, 5))
@example(walls=BRAKING, ends=7, horizon=1)
def test_it_finds_a_way_where_one_of_all_sequences_is_one(walls, ends, horizon) -> None:
    """Compared with every sequence, driven from the start: free ones up to the horizon, then one action repeated."""
    grid = Grid(walls, ends)
    found, contacts = way_out(grid, horizon)
    rest = [number for number, name in NAMES.items() if name in REST]
    free = itertools.product(NAMES, repeat=horizon)
    every = (
        (*some, *[last] * (5 - horizon)) for some in free for last in (rest if horizon < 5 else rest[:1])
    )
    assert (found is not None) == any(survives(grid, actions) for actions in every)
    if found is None:
        assert contacts > 0
    else:
        assert survives(grid, found)
        assert len(found) == min(5, ends)
    assert grid.state == (0, 1, 1, 0)
    assert Grid.open == 0


def test_five_seconds_are_steps_of_the_policy() -> None:
    found, _ = way_out(Grid(frozenset(), frequency=3))
    assert found == (1,) * 15


@pytest.mark.slow
@pytest.mark.parametrize("backend", ["sumo", "replica", "highway-env"])
def test_what_is_found_in_copies_comes_true_in_the_environment(backend: str) -> None:
    """A crash of a driver who always accelerates; driven from its start with the actions found, there is none."""
    if backend != "sumo":
        pytest.importorskip({"replica": "numba", "highway-env": "highway_env"}[backend])
    env = make_env(backend, "u-turn", {"vehicles_count": 3, "duration": 10})
    faster = 3
    row = None
    for scenario in range(30):
        row = play(env, Constant(faster), Drive("u-turn", 1, "risky", scenario))
        if row["crashed"] and row["length"] > 1:
            break
    assert row["crashed"]
    record = {"key": {"task": "u-turn", "level": 1, "kind": "baseline", "policy": "faster"}, "source": None}
    with rewound(Case(Store(Path("results")), "faster", record, row), env) as (copies, driven):
        for step in reversed(range(len(driven))):
            free, _ = way_out(copies[step])
            if free is not None:
                break
    actions = driven[:step] + free
    env.reset(seed=scenario_seed("u-turn", 1, scenario), options={"config": {"risk": 1.0}})
    assert not any(env.step(action)[-1]["crashed"] for action in actions)
    env.close()
