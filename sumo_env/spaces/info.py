"""The ``info`` of a step, and how an episode has ended."""

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import gymnasium as gym

from sumo_env.contacts.measures import NEAR_MISS_TTC, density
from sumo_env.scene import Place, Scene
from sumo_env.simulator import EgoStep
from sumo_env.tasks.base import EgoState


def paid_late() -> float:
    """The reward of a step after the end of an episode, with a warning."""
    gym.logger.warn("this episode is over, and a step after its end pays 0: call reset()")
    return 0.0


def information(
    scene: Scene,
    met: EgoStep,
    *,
    arrived: bool,
    on_road: bool,
    rewards: Mapping[str, float],
    action: Any,
    ending: str,
) -> dict[str, Any]:
    """The ``info`` of a step, or of a reset with the action type's `no_action`; see `DrivingEnv.step`.

    The same keys with values of the same types always, none of them None or NaN, so that libraries can store and merge
    it: without a crash its record is empty, because gymnasium cannot merge None and a record.
    """
    crashed = bool(scene.crashed[0])
    info = {
        "speed": float(scene.speed[0]),
        "crashed": crashed,
        "arrived": bool(arrived),
        "on_road": bool(on_road),
        "action": action,
        "rewards": {name: float(value) for name, value in rewards.items()},
        "cost": float(crashed),
        "crash": {} if met.crash is None else asdict(met.crash),
        "ending": ending,
        "density": density(scene.x, scene.y),
        "min_ttc": 0.0 if crashed else float(met.min_ttc),
        "min_ttc_before_contact": float(met.min_ttc),
        "near_miss": bool(met.min_ttc < NEAR_MISS_TTC) and not crashed,
        "distance": float(met.distance),
        "traffic_light": int(scene.light.state),
        "traffic_light_distance": float(scene.light.distance),
    }
    if "goal_reward" in rewards:  # highway-env's word, where it is no end
        info["is_success"] = info["arrived"]
    return info if scene.near_events is None else info | scene.near_events._asdict()


def ending(ego: EgoState, arrived: bool, terminated: bool, truncated: bool) -> str:
    """How an episode has ended, for ``info["ending"]``; "" while it goes on.

    "crash", "arrived", "missed turn", "lane ended", "removed" (by SUMO), "off road", "own rule" (of a subclass, or a
    red light), or "time".
    """
    if not terminated:
        return "time" if truncated else ""
    if ego.crashed or arrived:
        return "crash" if ego.crashed else "arrived"
    return ego.ended or ("own rule" if ego.on_road else "off road")


def on_its_way(place: Place) -> dict[str, Any]:
    """What ``info`` has beside on a network with SUMO's own traffic."""
    return {
        "missed_turn": place.ended == "missed turn",
        "removed": place.ended == "removed",
        "red_light": place.red_lights > 0,
        "vehicles_waiting": place.waiting,
        "fuel": place.fuel,
        "electricity": place.electricity,
        "overlap": place.overlap,
    }
