"""The ``info`` of a step: the same keys with values of the same types always, so that libraries can store and merge it.

No value is None or NaN, and nothing comes or goes: where there is no crash its record is empty strings and zeros.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

from sumo_env.contacts.crash import CrashRecord
from sumo_env.contacts.measures import NEAR_MISS_TTC, density
from sumo_env.scene import Scene

NO_ACTION = -1  # at a reset
NO_CRASH: dict[str, Any] = {
    field.name: "" if field.name in ("other", "type", "detected_by") else 0.0 for field in fields(CrashRecord)
}


def information(
    scene: Scene,
    crash: CrashRecord | None,
    min_ttc: float,
    distance: float,
    *,
    arrived: bool,
    on_road: bool,
    rewards: Mapping[str, float],
    action: int | None,
) -> dict[str, Any]:
    """The ``info`` of a step, or of a reset with `action` None; see `DrivingEnv.step`.

    `min_ttc` is the least time to collision before a contact [s].
    """
    crashed = bool(scene.crashed[0])
    return {
        "speed": float(scene.speed[0]),
        "crashed": crashed,
        "arrived": bool(arrived),
        "on_road": bool(on_road),
        "action": NO_ACTION if action is None else int(action),
        "rewards": {name: float(value) for name, value in rewards.items()},
        "cost": float(crashed),
        "crash": dict(NO_CRASH) if crash is None else crash.as_dict(),
        "density": density(scene.x, scene.y),
        "min_ttc": 0.0 if crashed else float(min_ttc),
        "min_ttc_before_contact": float(min_ttc),
        "near_miss": bool(min_ttc < NEAR_MISS_TTC) and not crashed,
        "distance": float(distance),
        "traffic_light": int(scene.light.state),
        "traffic_light_distance": float(scene.light.distance),
    }
