"""What every simulator is to the environment: a scenario goes in, then commands go in and steps come out.

`DrivingEnv` holds one `Simulator` and knows nothing else of it: SUMO in this process, SUMO in a process of its own,
or a simulator without SUMO. All that crosses this line is a value that can be printed, compared, stored and sent to
another process; neither side ever writes into the other.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Protocol

from sumo_env.contacts.crash import CrashRecord
from sumo_env.networks.roads import LaneIndex
from sumo_env.scene import Scene
from sumo_env.traffic.scenario import Scenario


class SimulatorError(RuntimeError):
    """A simulator cannot go on with an episode; the next `reset` begins another one."""


class EgoCommand(NamedTuple):
    """What the ego is told for one policy step, after a meta-action was applied (``MDPVehicle.act``).

    Attributes:
        target_speed: [m/s], approached with highway-env's first-order lag of 0.6 s.
        target_lane: lane to steer for.
    """

    target_speed: float
    target_lane: LaneIndex


@dataclass(frozen=True, slots=True)
class Step:
    """What one policy step has brought.

    Attributes:
        scene: at the end of the step.
        target_lane: lane that the ego steers for at the end; at the end of a lane it goes on to the next of its route.
        crash: the ego's first contact of the episode, in this step or an earlier one; None without one.
        min_ttc: least time to collision of the ego with any vehicle within 100 m after any sub-step [s], inf without
            one within 10 s.
        distance: covered by the ego in this step [m].
        trace: the scene after every sub-step, the last one included; empty unless it was asked for.
    """

    scene: Scene
    target_lane: LaneIndex
    crash: CrashRecord | None
    min_ttc: float
    distance: float
    trace: tuple[Scene, ...] = ()


class Simulator(Protocol):
    """Drives the traffic of one scenario after another."""

    def reset(self, scenario: Scenario) -> Scene:
        """Place a scenario, drive its warm-up, and return the first scene. The episode before is forgotten.

        The ego begins with the lane and the target speed of its `VehicleSpec`.
        """
        ...

    def step(self, command: EgoCommand, trace: bool = False) -> Step:
        """Drive one policy step: ``1 / scenario.policy_frequency`` seconds in sub-steps of the simulation frequency.

        Before the first sub-step, vehicles that have left the scene are removed and the scenario's spawns of this
        step are let in (highway-env does so after the observation of the step before, which is the same).
        """
        ...

    def close(self) -> None:
        """Give back what the simulator holds; `reset` takes it again."""
        ...
