"""What is asked for, and why: written down before the results were looked at, and never fitted to them.

A margin is the largest difference from highway-env (variant ``path``, 15 Hz) that would not change what a
researcher concludes. A check passes if the measured difference lies within it; *equivalence* is claimed only
where the whole 90 % interval does (two one-sided tests at 5 %).
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Margin:
    """A bound on |SUMO - highway-env|, in `unit`, with its reason. `relative`: as a share of highway-env's."""

    value: float
    unit: str
    reason: str
    relative: bool = False


# -- one vehicle or a few: no chance involved, so the bounds are tight ---------------------------------------------

DYNAMICS: dict[str, Margin] = {
    "follow_speed": Margin(
        0.5,
        "m/s",
        "root mean square over the manoeuvre; a fifth of the spread of desired speeds in the traffic",
    ),
    "follow_gap": Margin(1.5, "m", "root mean square; a third of a vehicle, the grain of a collision"),
    "stop_gap": Margin(0.5, "m", "where a follower comes to rest; a tenth of the distance kept in a jam"),
    "ladder_speed": Margin(
        0.02, "m/s", "the ego's law is the same formula in both, so only rounding may differ"
    ),
    "flip_time": Margin(0.1, "s", "one step of SUMO: when the ego counts as being on the new lane"),
    "moved_after_1s": Margin(
        0.6, "m", "distance kept between cars that pass side by side is 2 m; a third of it"
    ),
    "settled_time": Margin(0.8, "s", "less than one decision of the agent"),
    "turn_speed": Margin(
        0.05, "m/s", "the ego must not be slowed by bends, as highway-env has no such limit"
    ),
    "turn_position": Margin(1.0, "m", "mean distance of the two egos through a bend; half a vehicle's width"),
    "bend_progress": Margin(
        0.05, "1", "ground covered by other traffic through a bend; the bound on traffic speed", relative=True
    ),
    "placement": Margin(0.5, "m", "where a vehicle stands after a reset; a quarter of its width"),
}

# -- lane-change decisions of the traffic -------------------------------------------------------------------------

CHANGES: dict[str, Margin] = {
    "changes_valid": Margin(0.05, "1", "share of changes that satisfy MOBIL's criteria; one in twenty"),
    "valid_made": Margin(0.10, "1", "share of MOBIL's chances that are taken; they last a second or so"),
    "change_rate": Margin(
        0.25,
        "1",
        "changes per vehicle-minute; the rate differs by as much between 10 and 15 Hz",
        relative=True,
    ),
}

# -- episodes, regular traffic, traffic model `matched` -----------------------------------------------------------

RETURN_RANGE: dict[str, float] = {
    "highway": 20.0,  # 1 a step for 20 s
    "two-way": 15.0,
    "roundabout": 11.0,
    "intersection": 14.0,  # -5 to 9
    "u-turn": 10.0,
}

EPISODES: dict[str, Margin] = {
    "traffic_speed": Margin(
        0.05, "m/s", "5 % of the mean: the spread of desired speeds is 7 %", relative=True
    ),
    "headway": Margin(
        0.15,
        "s",
        "Wasserstein distance as a share of the mean: what halves or doubles braking moves it by more",
        relative=True,
    ),
    "crashed": Margin(0.10, "1", "a treatment of this study is calibrated to 0.15 to 0.25"),
    "return": Margin(
        0.10, "1", "a tenth of the task's range of returns, the size of effects worth reporting"
    ),
    "agreement": Margin(
        0.05, "1", "share of episodes with the same crash outcome, below that of highway-env at 10 and 15 Hz"
    ),
    "order": Margin(0.0, "1", "which of two egos is better must never depend on the simulator"),
}

REASON_WITHOUT = "shown without a target: SUMO's own models are not meant to be highway-env's"
