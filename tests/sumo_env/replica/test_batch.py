"""Batches of the replica: every environment drives the episodes of the single one with its seed, to the bit."""

from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import SyncVectorEnv

from sumo_env.config import Config, ConfigError
from sumo_env.replica.batch import reward_weights
from sumo_env.replica.env import OBSERVATIONS, ReplicaEnv
from sumo_env.replica.vector import ReplicaVectorEnv, make
from sumo_env.spaces.approach import APPROACH
from sumo_env.tasks import TASKS
from sumo_env.tasks.base import EgoState
from sumo_env.tasks.u_turn import UTurn
from tests.sumo_env.rollout import assert_same_bits
from tests.tasks import OF_HIGHWAY_ENV

ENVS = 4
# Of the single environment's info.
LEFT_OUT = {"rewards", "crash", "ending", "traffic_light", "traffic_light_distance", "acceleration", "jerk"}
SEE_BEHIND = {"type": "Kinematics", "see_behind": True, "features": ["x", "cos_h"]}
STEERING = {"type": "ContinuousAction"}
APPROACHING = {"type": "Kinematics", "absolute": True, "features": ["presence", "x", *APPROACH]}
DYNAMICAL = {"action": {**STEERING, "dynamical": True}, "observation": {"type": "Kinematics"}}
SEEDED: dict[str, Any] = {"scenarios": "seeded"}


def pair(
    task: str, mode: str = "NextStep", threads: int = 1, version: int = 0, **keywords: Any
) -> tuple[Any, Any]:
    """A batch, and gymnasium's loop over single environments."""
    spec = gym.spec(f"replica/{task}-v{version}")
    ours = gym.make_vec(spec, num_envs=ENVS, autoreset_mode=mode, threads=threads, **keywords)
    loop = {"autoreset_mode": mode}
    theirs = gym.make_vec(spec, num_envs=ENVS, vectorization_mode="sync", vector_kwargs=loop, **keywords)
    assert isinstance(ours, ReplicaVectorEnv) and isinstance(theirs, SyncVectorEnv)
    for space in ("observation_space", "action_space", "single_observation_space", "single_action_space"):
        assert getattr(ours, space) == getattr(theirs, space)
    assert ours.metadata["autoreset_mode"] is theirs.metadata["autoreset_mode"]
    return ours, theirs


def assert_equal(ours: Any, theirs: Any) -> None:
    """Of infos, all that the batch has, which is all but LEFT_OUT."""
    assert_same_bits(ours, theirs, LEFT_OUT)


def drawn(envs: Any, rng: np.random.Generator) -> np.ndarray:
    """Random actions; of numbers, one has the 0 that the roundabout's reward takes for a lane change."""
    if isinstance(envs.single_action_space, gym.spaces.Discrete):
        return rng.integers(envs.single_action_space.n, size=ENVS)
    numbers = rng.uniform(-1.0, 1.0, envs.action_space.shape).astype(np.float32)
    numbers[rng.integers(ENVS), -1] = 0.0
    return numbers


def drive_both(envs: tuple[Any, Any], steps: int, seed: int) -> int:
    """The same random actions for both; returns how many episodes ended."""
    rng, ended = np.random.default_rng(seed), 0
    for _ in range(steps):
        actions = drawn(envs[0], rng)
        ours, theirs = (env.step(actions) for env in envs)
        assert_equal(ours, theirs)
        over = ours[2] | ours[3]
        ended += int(over.sum())
        if over.any() and envs[0].metadata["autoreset_mode"].value == "Disabled":
            assert_equal(*(env.reset(options={"reset_mask": over.copy()}) for env in envs))
    return ended


@pytest.mark.parametrize("mode", ["NextStep", "SameStep", "Disabled"])
@pytest.mark.parametrize(("task", "threads"), [("two-way", 1), ("two-way", 2), ("intersection", 2)])
def test_autoreset_and_threads(mode: str, task: str, threads: int) -> None:
    """A reset without a seed goes on with the generators, whatever was drawn ahead, as at the intersection."""
    envs = pair(task, mode, threads, scenarios="seeded", config={"risk": 1.0})
    assert_equal(*(env.reset(seed=[5, 1, 8, 1]) for env in envs))
    drive_both(envs, 12, seed=0)
    assert_equal(*(env.reset() for env in envs))
    drive_both(envs, 12, seed=1)
    assert_equal(*(env.reset(options={"config": {"risk": 0.0, "duration": 3}}) for env in envs))
    drive_both(envs, 12, seed=2)
    risky = {"config": {"risk": 1.0}, "risk_rates": {"cut_in": 0.9}}
    assert_equal(*(env.reset(seed=2, options=risky) for env in envs))
    assert drive_both(envs, 12, seed=3) > ENVS


CASES: list[tuple[str, dict[str, Any]]] = [
    # lightest traffic of every task, and densest with risk
    *(
        (task, {**SEEDED, "config": {**list(TASKS[task].levels.values())[index], "risk": risk}})
        for task in OF_HIGHWAY_ENV
        for index, risk in ((0, 0.0), (-1, 1.0))
    ),
    # highway-env's episodes, with the arrivals at the intersection, which it draws during an episode
    *(
        (task, {"config": {"observation": {"type": "Kinematics"}} if task in OBSERVATIONS else {}})
        for task in (*OF_HIGHWAY_ENV, "highway-fast")
    ),
    ("intersection", {"config": {"neighbour_vehicles_connected_lanes": True, "destination": None}}),
    # options
    ("highway", {**SEEDED, "config": {"offroad_terminal": True, "normalize_reward": False}}),
    ("highway", {**SEEDED, "config": {"action": {"type": "DiscreteMetaAction", "longitudinal": False}}}),
    ("intersection", {**SEEDED, "config": {"normalize_reward": True, "policy_frequency": 3}}),
    ("roundabout", {**SEEDED, "variant": "path", "config": {"risk": 0.7}}),
    ("roundabout", {**SEEDED, "risk_law": "linear", "config": {"risk": 0.7}}),
    ("u-turn", {**SEEDED, "variant": "connected", "config": {"observation": SEE_BEHIND}}),
    ("roundabout", {**SEEDED, "config": {"observation": APPROACHING}}),
    # steering
    ("intersection", {"version": 1}),
    ("highway", {"mode": "SameStep", "threads": 2, "config": {"action": STEERING}}),
    ("two-way", {"config": {"action": STEERING, "observation": {"type": "Kinematics"}}}),
    ("roundabout", {"version": 1, "threads": 2, "config": {"action": {**STEERING, "lateral": False}}}),
    ("roundabout", {"config": {"action": {"type": "DiscreteAction"}}}),
    ("u-turn", {"version": 1, "mode": "SameStep", "threads": 2, "config": DYNAMICAL}),
]


@pytest.mark.parametrize(("task", "keywords"), CASES, ids=str)
def test_episodes_are_those_of_single_environments(task: str, keywords: dict[str, Any]) -> None:
    envs = pair(task, **keywords)
    assert_equal(*(env.reset(seed=7) for env in envs))
    ended = drive_both(envs, 40, seed=7)
    if ended < 2 * ENVS:  # where episodes are long
        ended += drive_both(envs, 40, seed=8)
    assert ended >= 2 * ENVS


@pytest.mark.parametrize(
    "keywords",
    [
        {},  # highway-env's observation of the u-turn is TimeToCollision
        {"config": {"observation": {"type": "Kinematics", "order": "shuffled"}}},
        {"config": {"observation": {"type": "Kinematics", "features": ["x", "cos_d"]}}},
        {"config": {"observation": {"type": "Kinematics"}}, "render_mode": "rgb_array"},
    ],
    ids=str,
)
def test_what_the_kernels_do_not_know_is_driven_by_single_environments(keywords: dict[str, Any]) -> None:
    with pytest.warns(UserWarning, match="take turns"):
        envs = gym.make_vec("replica/u-turn-v0", num_envs=2, autoreset_mode="SameStep", **keywords)
    assert type(envs) is SyncVectorEnv and envs.metadata["autoreset_mode"].value == "SameStep"
    envs.reset(seed=0)
    envs.step(np.array([1, 1]))


def test_a_reset_is_asked_for_and_checked() -> None:
    envs = gym.make_vec("replica/highway-v0", num_envs=2, autoreset_mode="Disabled", config={"duration": 1})
    with pytest.raises(gym.error.ResetNeeded):
        envs.step([1, 1])
    with pytest.raises(ValueError, match="2 seeds"):
        envs.reset(seed=[1, 2, 3])  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="reset_mask"):
        envs.reset(options={"reset_mask": np.array([True])})
    with pytest.raises(ConfigError, match="sync"):
        envs.reset(options={"config": {"duration": 2}, "reset_mask": np.array([True, False])})
    with pytest.raises(ValueError, match="another batch"):
        envs.reset(options={"config": {"observation": {"type": "TimeToCollision"}}})
    envs.reset(seed=0)  # with the configuration from before
    envs.step(np.array([1, 1], np.uint8))
    with pytest.raises(AssertionError, match="reset them"):
        envs.step([1, 1])


def test_returned_arrays_stay_as_they_are() -> None:
    envs = gym.make_vec("replica/highway-v0", num_envs=2)
    first, infos = envs.reset(seed=1)
    step = envs.step([1, 3])
    kept = [first.copy(), infos["speed"].copy(), *(part.copy() for part in step[:4])]
    envs.step([4, 4])
    for one, other in zip([first, infos["speed"], *step[:4]], kept, strict=True):
        np.testing.assert_array_equal(one, other)


class Slalom(UTurn):
    """A task of one's own on a road of the five."""

    name = "slalom"

    def rewards(self, ego: EgoState, config: Config) -> dict[str, float]:
        return {"collision_reward": 3.0, "on_road_reward": 1.0}


def test_a_task_of_ones_own_is_paid_its_own_reward_or_refused() -> None:
    """Never the reward of another task; highway-env has no draws of its traffic."""
    with pytest.warns(UserWarning, match="take turns"):
        envs: Any = make(2, task=Slalom(), **SEEDED, config={"normalize_reward": False})
    envs.reset(seed=0)
    assert envs.step(np.array([1, 1]))[1].tolist() == [-3.0, -3.0]
    with pytest.raises(ConfigError, match=r"no reward of the task 'slalom'"):
        reward_weights(Slalom(), envs.envs[0].config)
    with pytest.raises(ConfigError, match=r"task 'slalom' are not known"):
        ReplicaEnv(Slalom()).reset(seed=0)


@pytest.mark.parametrize(
    ("task", "keywords"),
    [
        ("u-turn", {**SEEDED, "config": {"risk": 1.0}}),
        ("intersection", {}),  # arrivals are drawn during an episode
    ],
)
def test_copies_go_on_as_the_environments_that_they_are_of(task: str, keywords: dict[str, Any]) -> None:
    """Over the ends of episodes, whatever others that were copied from the same ones do meanwhile."""
    envs, rows, rng = pair(task, **keywords)[0], [2, 0, 2, 3], np.random.default_rng(0)
    with pytest.raises(gym.error.ResetNeeded):
        envs.copies(rows)
    envs.reset(seed=5)
    for _ in range(7):
        envs.step(drawn(envs, rng))
    others, copies = envs.copies([2, 0, 1, 2]), envs.copies(rows)
    ended = 0
    for _ in range(20):
        others.step(drawn(others, rng))
        actions = drawn(envs, rng)
        (*theirs, infos), ours = envs.step(actions), copies.step(actions[rows])
        infos = {name: values[rows] for name, values in infos.items()}
        assert_equal(ours, (*(part[rows] for part in theirs), infos))
        np.testing.assert_array_equal(copies.egos["x"], envs.egos["x"][rows])
        ended += int((ours[2] | ours[3]).sum())
    assert ended and copies.action_space.shape == (len(rows),)
