"""The ``info`` of a step: the same keys with values of the same types always, so that libraries can store and merge it.

No value is None or NaN, and nothing comes or goes: where there is no crash its record is empty strings and zeros.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

from sumo_env.contacts.crash import CrashRecord
from sumo_env.contacts.measures import NEAR_MISS_TTC
from sumo_env.scene import NO_LIGHT, Light

NO_ACTION = -1  # at a reset
NO_CRASH: dict[str, Any] = {
    field.name: "" if field.name in ("other", "type", "detected_by") else 0.0 for field in fields(CrashRecord)
}


def information(
    *,
    speed: float,
    crashed: bool,
    arrived: bool,
    on_road: bool,
    rewards: Mapping[str, float],
    crash: CrashRecord | None,
    density: int,
    min_ttc: float,
    distance: float,
    action: int | None,
    light: Light = NO_LIGHT,
) -> dict[str, Any]:
    """The ``info`` of a step, or of a reset with `action` None; see `DrivingEnv.step`.

    `min_ttc` is the least time to collision before a contact [s].
    """
    return {
        "speed": float(speed),
        "crashed": bool(crashed),
        "arrived": bool(arrived),
        "on_road": bool(on_road),
        "action": NO_ACTION if action is None else int(action),
        "rewards": {name: float(value) for name, value in rewards.items()},
        "cost": float(crashed),
        "crash": dict(NO_CRASH) if crash is None else crash.as_dict(),
        "density": int(density),
        "min_ttc": 0.0 if crashed else float(min_ttc),
        "min_ttc_before_contact": float(min_ttc),
        "near_miss": bool(min_ttc < NEAR_MISS_TTC and not crashed),
        "distance": float(distance),
        "traffic_light": int(light.state),
        "traffic_light_distance": float(light.distance),
    }
