"""On a processor of another kind: the doctor, the first steps of the golden episodes, and copies of an episode."""

import copy
import platform

import gymnasium as gym
import numpy as np

from sumo_env import IDS, task_of
from sumo_env import __main__ as doctor
from tests.golden import scenes
from tests.golden.regenerate import read


def main() -> None:
    """An error if anything is not as on x86-64."""
    print(platform.machine(), flush=True)
    assert doctor.examine(doctor.CHECKS) == 0
    for task in map(task_of, IDS):
        found = scenes.differences(scenes.table(task), read(task))
        assert not found, (task, *found[:5])
        print(f"  ok    {task}: scenes as the golden ones", flush=True)
    envs = [gym.make("sumo/roundabout-v0", config={"risk": 1.0}) for _ in range(2)]
    for env in envs:
        env.reset(seed=1)
    envs += [copy.deepcopy(env) for env in envs]  # of this process's simulation, and of a worker's
    for action in (1, 3, 0, 1):
        first, *others = (env.step(action)[0] for env in envs)
        assert all(np.array_equal(first, other) for other in others)
    print("  ok    copies")


if __name__ == "__main__":
    main()
