"""The row of a test episode, on which every published number stands."""

from dataclasses import asdict
from itertools import product
from typing import Any

import gymnasium as gym
import pytest

from experiments.study.compute.evaluate import Drive, play, play_from
from experiments.study.design.traffic import TRAFFICS
from sumo_env.contacts.crash import CrashRecord

# Of each step: speed [m/s], distance [m], time to collision [s], near miss, vehicles near, reward, action.
STEPS = [
    (0.9, 1.0, 4.0, False, 3, 0.1, 3),
    (0.0, 0.0, 0.4, True, 5, 0.2, 1),
    (1.0, 2.0, 1.2, True, 4, 0.4, 3),
]
CRASH = CrashRecord("v3", 2.8, 7.0, 4.0, 5.0, 0.5, 0.1, 9.0, "rear-end", "both")


class Told(gym.Env):
    """An episode that is told in advance; a contact comes in its last step, which is also that of the time limit."""

    def __init__(self, crashes: bool) -> None:
        self.crashes, self.time = crashes, 0

    def reset(self, **_: Any) -> tuple[int, dict[str, Any]]:
        return 0, {}

    def step(self, action: int) -> tuple[int, float, bool, bool, dict[str, Any]]:
        speed, distance, ttc, is_near, density, reward, wanted = STEPS[self.time]
        assert action == wanted
        self.time += 1
        ends = self.time == len(STEPS)
        crashed = self.crashes and ends
        info = {"speed": speed, "distance": distance, "min_ttc_before_contact": ttc, "near_miss": is_near}
        info |= {"density": density, "crashed": crashed, "arrived": False, "min_ttc": 0.0}
        return self.time, reward, crashed, ends, {**info, "crash": asdict(CRASH) if crashed else {}}


class Acts:
    def act(self, observation: Any) -> int:
        return STEPS[observation][-1]

    def reset(self, seed: int | None = None) -> None:
        """It has no state."""


@pytest.mark.parametrize("crashes", [True, False])
def test_a_row_is_what_the_steps_of_the_episode_say(crashes: bool) -> None:
    row = play_from(Told(crashes), Acts(), 0, {})
    crash = asdict(CRASH) if crashes else dict.fromkeys(asdict(CRASH))
    assert row == pytest.approx(
        {
            "return": 0.7, "length": 3, "crashed": crashes, "arrived": False, "truncated": not crashes,
            "mean_speed": 1.9 / 3, "distance": 3.0, "min_ttc": 0.4, "near_misses": 2, "density": 4.0,
            "stopped": 2 / 3, "actions": "313",
            "action_0": 0, "action_1": 1, "action_2": 0, "action_3": 2, "action_4": 0,
            **{f"crash_{name}": value for name, value in crash.items()},
        }
    )  # fmt: skip


def test_a_policy_draws_otherwise_in_every_episode(monkeypatch: pytest.MonkeyPatch) -> None:
    seeds: list[int] = []
    monkeypatch.setattr(Acts, "reset", lambda _, seed: seeds.append(seed))
    for traffic, scenario in product(TRAFFICS, (0, 1)):
        play(Told(False), Acts(), Drive("u-turn", 1, traffic, scenario))
    assert len(set(seeds)) == 4
