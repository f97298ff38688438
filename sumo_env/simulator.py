"""The interface between the environment and a simulator: a scenario and commands go in, scenes and steps come out.

`DrivingEnv` holds one `Simulator` and knows nothing else about it: SUMO in this process, SUMO in a process of its own,
or a simulator without SUMO. Everything that is exchanged is a value that can be printed, compared, stored and sent to
another process; neither side modifies the other's state.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

from sumo_env.contacts.crash import CrashRecord
from sumo_env.networks.roads import LaneIndex
from sumo_env.scene import Scene
from sumo_env.traffic.scenario import Scenario

LANE_ENDED = "lane ended"  # the ego has come to the end of a lane that ends before the road does


class SimulatorError(RuntimeError):
    """A simulator cannot continue an episode; `reset` starts another one."""


class WindowClosed(SimulatorError):
    """The user has closed SUMO's own window, and the simulation with it."""


class EgoCommand(NamedTuple):
    """The ego's command for one policy step, after the meta-action was applied (``MDPVehicle.act``).

    SUMO as the simulator also takes None for the speed or the lane: then SUMO drives the ego as it drives others.

    Attributes:
        target_speed: [m/s]; None for SUMO's car following.
        target_lane: lane to steer for; None for SUMO's lane changes.
        acceleration: at which the ego approaches the target speed [m/s2], from above or from below; None for
            highway-env's first-order lag of 0.6 s.
    """

    target_speed: float | None
    target_lane: LaneIndex | None
    acceleration: float | None = None


class SteeringCommand(NamedTuple):
    """The ego's pedals and steering wheel, which stay as they are for one policy step (``Vehicle.act``).

    Simulators that move cars along lanes, as SUMO does, have no use for it.

    Attributes:
        acceleration: [m/s2].
        steering: angle of the front wheels [rad].
        speed_range: speeds beyond which the ego is slowed down softly [m/s]; None: highway-env's 40 m/s either way.
        dynamical: whether tyres slip (``BicycleVehicle``); the same in all steps of an episode.
    """

    acceleration: float
    steering: float
    speed_range: tuple[float, float] | None = None
    dynamical: bool = False


Command = EgoCommand | SteeringCommand
# What each learning car does in a policy step, by its id. None takes a car off the road, for good.
Commands = Mapping[str, Command | None]


class EgoStep(NamedTuple):
    """What one learning car has met in a policy step.

    Attributes:
        target_lane: lane that it steers for at the end; at the end of a lane this is the next lane of its route.
        crash: its first contact of the episode, in this step or an earlier one; None without one.
        min_ttc: least time to collision with any vehicle within 100 m after any sub-step [s], inf without one within
            10 s.
        distance: covered in this step [m].
        ended: how its way has ended, for `info.ending`; "" where it goes on. Endings on SUMO's own networks: `Place`.
    """

    target_lane: LaneIndex
    crash: CrashRecord | None
    min_ttc: float
    distance: float
    ended: str = ""


@dataclass(frozen=True, slots=True)
class Step:
    """The result of one policy step.

    Attributes:
        scene: at the end of the step.
        egos: of each learning car on the road, by its id, in the order of the scene's rows.
        trace: the scene after every sub-step, the last one included; empty unless it was asked for.
    """

    scene: Scene
    egos: Mapping[str, EgoStep]
    trace: tuple[Scene, ...] = ()

    @property
    def ego(self) -> EgoStep:
        """Of the first learning car."""
        return next(iter(self.egos.values()))


class Simulator(Protocol):
    """Drives the traffic of one scenario after another; `copy.deepcopy` of it goes on by itself from the same state."""

    def reset(self, scenario: Scenario) -> Scene:
        """Place a scenario, drive its warm-up, and return the first scene. The previous episode ends.

        A learning car starts with the lane and the target speed of its `VehicleSpec`.
        """

    def step(self, commands: Any, trace: bool = False) -> Step:
        """Drive one policy step: ``simulation_frequency // policy_frequency`` sub-steps of the scenario.

        `Commands` are an `EgoCommand` for each learning car or, for a simulator that can steer, a `SteeringCommand`.
        SUMO drives a learning car without a command; the replica goes on with the targets that such a car has.

        Before the first sub-step, vehicles that have left the scene are removed and the scenario's spawns of this
        step are added (highway-env does this after the observation of the previous step, which is equivalent).
        """

    def imagine(self, scenario: Scenario) -> None:
        """Go on with the risk events of this scenario that have not begun, on the replica also with its drivers."""

    def close(self) -> None:
        """Release what the simulator holds; `reset` acquires it again."""
