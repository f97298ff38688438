"""What an imagined copy of an episode does not know of the drivers: it draws new parameters."""

from __future__ import annotations

from dataclasses import replace

from sumo_env.replica.draws import DELTA, DELTA_RANGE
from sumo_env.streams import stream
from sumo_env.traffic.scenario import Scenario, VehicleSpec


def with_other_drivers(scenario: Scenario, seed: int) -> Scenario:
    """The scenario with another driver in every vehicle but the ego.

    A driver of a pool is replaced by one of the same pool. Of highway-env's own drivers the exponent of IDM is drawn,
    which is what ``IDMVehicle.randomize_behavior`` draws, unless it is the one that drivers have without it. The seed
    of the scenario becomes this one, which decides on `linear.linear_drivers`.
    """
    rng = stream(seed, "imagined drivers")
    pool_of = {driver.type: pool.drivers for pool in scenario.pools for driver in pool.drivers}

    def other(spec: VehicleSpec) -> VehicleSpec:
        driver = spec.driver
        if driver.type in pool_of:
            pool = pool_of[driver.type]
            driver = pool[rng.integers(len(pool))]
        elif driver.delta != DELTA:
            driver = replace(driver, delta=float(rng.uniform(*DELTA_RANGE)))
        return spec._replace(driver=driver)

    vehicles = tuple(other(spec) for spec in scenario.vehicles)
    spawns = tuple(replace(spawn, vehicle=other(spawn.vehicle)) for spawn in scenario.spawns)
    return replace(scenario, seed=seed, vehicles=vehicles, spawns=spawns)
