"""What a learning car sees near it, sub-step by sub-step."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest

from sumo_env.contacts.measures import TTC_RADIUS
from sumo_env.sumo.engine import Engine
from sumo_env.sumo.nearby_vehicles import FASTEST, Surroundings
from sumo_env.sumo.session import Session


@pytest.mark.parametrize("seed", range(4))
def test_whoever_is_near_is_seen_and_who_is_far_is_rarely_looked_at(seed: int) -> None:
    """Any vehicles as fast as may be, some towards the ego; one leaves and one comes in every sub-step, often by a name
    that has left."""
    rng, dt, looks = np.random.default_rng(seed), 0.1, 0
    names = [f"v{number}" for number in range(60)]
    places = {name: rng.uniform(-1500.0, 1500.0, 2) for name in names} | {"ego": np.zeros(2)}
    ways = {name: rng.uniform(-1.0, 1.0, 2) for name in places}
    ways |= {name: -places[name] for name in names[::4]}
    arrived: list[str] = []
    departed: list[str] = []

    def position(name: str) -> tuple[float, float]:
        nonlocal looks
        looks += 1
        return places[name][0].item(), places[name][1].item()

    vehicle = SimpleNamespace(
        getIDList=lambda: tuple(sorted(places)),
        getPosition=position,
        getSpeed=lambda _: 0.0,
        getAngle=lambda _: 0.0,
        getLength=lambda _: 5.0,
        getWidth=lambda _: 2.0,
    )
    simulation = SimpleNamespace(
        getArrivedIDList=lambda: arrived,
        getDepartedNumber=lambda: len(departed),
        getDepartedIDList=lambda: departed,
        getCollisions=tuple,
    )
    module = SimpleNamespace(vehicle=vehicle, simulation=simulation, simulationStep=lambda: None)
    session = Session(Engine(module, list, "", {}, ()))
    session._angle = vehicle.getAngle
    around = Surroundings(session, 0.0)
    for step in range(60):
        for name, place in places.items():
            fast = 0.999 * FASTEST if name in names[::4] else 0.0 if name == "ego" else FASTEST / 2.0
            places[name] = place + fast * dt * ways[name] / math.hypot(*ways[name])
        gone = rng.choice(names)
        arrived[:] = [gone] if places.pop(gone, None) is not None else []
        came = gone if rng.random() < 0.5 else rng.choice(names)
        departed[:] = [] if came in places else [came]
        for name in departed:
            places[name] = places["ego"] + rng.uniform(-200.0, 200.0, 2)
        session.step()
        if step % 20 == 0:
            around.list_vehicles()
        around.update(dt * step, 0.0)
        near = [name for name in sorted(places) if math.dist(places[name], places["ego"]) <= TTC_RADIUS]
        assert list(around.near) == [name for name in near if name != "ego"]
    assert looks < 0.6 * 60 * len(places)
