"""A simulator without SUMO, whose episodes do what a test asks for by their seed."""

import os
import signal
import time
from collections.abc import Mapping
from typing import TYPE_CHECKING, cast

import numpy as np

from sumo_env.config import ConfigError
from sumo_env.scene import Scene
from sumo_env.simulator import EgoCommand, EgoStep, Step
from sumo_env.sumo.process import SumoProcess
from sumo_env.traffic.scenario import Scenario, VehicleSpec

if TYPE_CHECKING:
    from sumo_env.traffic.drivers import Driver

FAKE = "tests.sumo_env.sumo.fake:FakeSimulator"

CONFIG_ERROR, FOREIGN_ERROR, HANGS, PRINTS, CRASHES_AT_RESET = range(100, 105)

COMMAND = EgoCommand(25.0, ("0", "1", 2))


class ForeignError(Exception):
    """Of a module that a client may not know, and with arguments that do not survive a pickle."""

    def __init__(self, first: int, second: int) -> None:
        super().__init__(f"{first} and {second}")


class FakeSimulator:
    """Drives the ego by its target speed, and everybody else not at all."""

    def reset(self, scenario: Scenario) -> Scene:
        self.seed, self.time, self.x = scenario.seed, 0.0, 0.0
        self.ids = tuple(spec.id for spec in scenario.specs)
        if self.seed == CRASHES_AT_RESET:
            os.kill(os.getpid(), signal.SIGSEGV)
        return self.scene()

    def step(self, commands: Mapping[str, EgoCommand], trace: bool = False) -> Step:
        command = commands["ego"]
        if self.seed == CONFIG_ERROR:
            raise ConfigError("a key that is not known")
        elif self.seed == FOREIGN_ERROR:
            raise ForeignError(1, 2)
        elif self.seed == HANGS:
            time.sleep(60.0)
        elif self.seed == PRINTS:
            print("SUMO says something", flush=True)
            os.write(1, b"and so does C++\n")
        self.time += 1.0
        self.x += command.target_speed
        scene = self.scene()
        ego = EgoStep(command.target_lane, None, np.inf, command.target_speed)
        return Step(scene, {"ego": ego}, (scene,) * 3 if trace else ())

    def scene(self) -> Scene:
        count = len(self.ids)
        x = np.linspace(0.0, self.seed, count)
        x[0] += self.x
        y, speed, heading = np.ones((3, count))
        return Scene(self.ids, x, y, speed, heading, np.zeros(count, np.bool_), self.time)

    def imagine(self, scenario: Scenario) -> None:
        pass

    def call(self, path: str, arguments: tuple[()], named: dict[str, object]) -> str:
        return path

    def close(self) -> None:
        pass


def open_simulator() -> SumoProcess:
    """As an environment has it: in this process if that is free."""
    return SumoProcess(FAKE, here=True)


def scenario(seed: int = 0, others: int = 3) -> Scenario:
    """Some vehicles; how they would drive is of no interest here."""
    driver = cast("Driver", None)
    names = ("ego", *(f"v{number}" for number in range(others)))
    place, speeds = (0.0,) * 4, (25.0, 25.0)
    ego, *vehicles = [VehicleSpec(one, COMMAND.target_lane, *place, *speeds, None, driver) for one in names]
    return Scenario("highway", seed, 0.5, ego, tuple(vehicles))
