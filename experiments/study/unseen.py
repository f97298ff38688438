"""Risky traffic that nobody was trained in: whether an agent is safer, or has seen the risk of its training.

Each is the traffic at dose 1 with something taken away or exchanged, on the same scenarios as every test.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import gymnasium as gym

from sumo_env.tasks import TASKS
from sumo_env.traffic.drivers import Driver
from sumo_env.traffic.scenario import Scenario

EVENTS = {"only-cut-in": "cut-in", "only-brake": "brake", "only-surge": "surge"}  # among regular drivers
PARAMETERS = "only-parameters"  # risky drivers without events
# SUMO's other car-following models, with the accelerations, headways and gaps of the risky drivers. Their random errors
# are off: SUMO would draw them from its own generator, and an episode would depend on those before it.
MODELS = {
    "krauss": {"carFollowModel": "Krauss", "sigma": 0},
    "eidm": {"carFollowModel": "EIDM", "sigmaerror": 0, "sigmaleader": 0, "sigmagap": 0},
}
UNSEEN = (*EVENTS, PARAMETERS, *MODELS)


def unseen_traffics(task: str, backend: str = "sumo") -> tuple[str, ...]:
    """The traffics of UNSEEN that differ from regular and risky traffic in a task, on a backend.

    Kinds of events that the task does not have are skipped, and SUMO's models on other simulators.
    """
    rates = TASKS[task].risk_rates
    present = {kind for kind in EVENTS.values() if getattr(rates, kind.replace("-", "_")) > 0}
    events = [name for name, kind in EVENTS.items() if kind in present]
    parameters = [PARAMETERS] if present else []
    return (*events, *parameters, *(MODELS if backend == "sumo" else ()))


class UnseenRisk(gym.Wrapper[Any, Any, Any, Any]):
    """An environment whose episodes have the traffic of this name, whatever dose of risk `reset` asks for."""

    def __init__(self, env: gym.Env[Any, Any], traffic: str) -> None:
        super().__init__(env)
        self._traffic = traffic

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Begin an episode: draw the scenario of the seed in regular and in risky traffic, and mix the two."""
        drawn: list[Scenario] = []
        for risk in (0.0, 1.0):
            self.env.reset(seed=seed, options={"config": {"risk": risk}})
            drawn.append(self.env.unwrapped.scenario)  # type: ignore[attr-defined]
        return self.env.reset(seed=seed, options={"scenario": unseen(self._traffic, *drawn)})


def unseen(traffic: str, regular: Scenario, risky: Scenario) -> Scenario:
    """The scenario of a traffic of UNSEEN, from those of one seed at dose 0 and 1."""
    if traffic in EVENTS:
        events = tuple(event for event in risky.events if event.kind == EVENTS[traffic])
        return replace(regular, events=events)
    if traffic == PARAMETERS:
        return replace(risky, events=())
    model = MODELS[traffic]

    def changed(driver: Driver) -> Driver:
        return driver.like(traffic, model)

    return replace(
        risky,
        vehicles=tuple(spec._replace(driver=changed(spec.driver)) for spec in risky.vehicles),
        spawns=tuple(
            replace(spawn, vehicle=spawn.vehicle._replace(driver=changed(spawn.vehicle.driver)))
            for spawn in risky.spawns
        ),
    )
