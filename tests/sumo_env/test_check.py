"""`check_task`: the five tasks and examples have no fault, and each rule of docs/own-parts.md names its own."""

from __future__ import annotations

import random
from typing import Any

import pytest

import sumo_env
from sumo_env.config import ConfigError
from sumo_env.tasks import TASKS
from sumo_env.tasks.highway import Highway


@pytest.mark.parametrize("name", TASKS)
def test_the_five_tasks_have_no_fault(name: str) -> None:
    sumo_env.check_task(TASKS[name], {"risk": 1.0})


class Random(Highway):
    """It draws from a generator that no seed sets."""

    def vehicles(self, *arguments: Any) -> list[Any]:
        return [spec._replace(speed=20 + random.random()) for spec in super().vehicles(*arguments)]


class Dosed(Highway):
    """Its vehicles are slower where they are risky."""

    def vehicles(self, config: Any, *arguments: Any) -> list[Any]:
        specs = super().vehicles(config, *arguments)
        return [spec._replace(speed=spec.speed - config["risk"]) for spec in specs]


class Weightless(Highway):
    """One term has no weight, another is no number."""

    def rewards(self, ego: Any, config: Any) -> dict[str, float]:
        return {**super().rewards(ego, config), "gap_reward": 1.0, "collision_reward": float("nan")}


class Own(Highway):
    """It weighs its terms itself, and they may have any name."""

    def rewards(self, ego: Any, config: Any) -> dict[str, float]:
        return {"progress": ego.s / 100.0}

    def reward(self, rewards: dict[str, float], config: Any) -> float:
        return rewards["progress"]


class Changing(Highway):
    """A term that comes and goes."""

    def rewards(self, ego: Any, config: Any) -> dict[str, float]:
        return {**super().rewards(ego, config), **({"headway_reward": 1.0} if ego.action == 1 else {})}


class Remembering(Highway):
    """What it has seen before decides what it pays."""

    steps = 0

    def rewards(self, ego: Any, config: Any) -> dict[str, float]:
        self.steps += 1
        return {**super().rewards(ego, config), "high_speed_reward": 1.0 / self.steps}


class Nowhere(Highway):
    """A vehicle beside the road, and an ego of another name."""

    def ego(self, *arguments: Any) -> Any:
        return super().ego(*arguments)._replace(id="me")

    def vehicles(self, *arguments: Any) -> list[Any]:
        first, *others = super().vehicles(*arguments)
        return [first._replace(lane=("0", "1", 9)), *others]


def faults(task: Any) -> str:
    with pytest.raises(ConfigError) as error:
        sumo_env.check_task(task, {"vehicles_count": 5})
    return str(error.value)


@pytest.mark.parametrize(
    ("task", "words"),
    [
        (Random(), ["a seed gives two scenarios: draw from rng"]),
        (Dosed(), ["1 fault(s)", "the dose of risk moves vehicles"]),
        (Weightless(), ["'gap_reward' of the reward has no weight", "'collision_reward' is nan"]),
        (Changing(), ["differ between steps"]),
        (Remembering(), ["1 fault(s)", "a seed gives two episodes"]),
        (Highway, ["not <class"]),
    ],
)
def test_faults_are_named(task: Any, words: list[str]) -> None:
    found = faults(task)
    assert [word for word in words if word not in found] == [], found


def test_places_that_are_none_are_named_before_sumo_sees_them() -> None:
    found = faults(Nowhere())
    assert "the ego is called 'me'" in found and "no lane ('0', '1', 9) for 'v0'" in found


def test_speeds_that_are_not_evenly_spaced_are_named() -> None:
    task = type("Uneven", (Highway,), {"target_speeds": (20.0, 21.0, 30.0)})()
    assert "not evenly spaced" in faults(task)


def test_a_task_that_weighs_its_own_terms_has_no_fault() -> None:
    sumo_env.check_task(Own(), {"vehicles_count": 5})
