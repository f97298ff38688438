"""How far SUMO's traffic may be from highway-env's before a researcher would conclude something else.

The margins were fixed before SUMO's drivers were validated with them, and are never fitted to results. A check is
judged by its point estimate; *equivalent* is said only where the whole 90 % interval lies inside the margin (two
one-sided tests at 5 %).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

# Range of the return of an episode.
RETURN_RANGE: dict[str, float] = {
    "highway": 20.0,  # at most 1 a step for 20 s
    "two-way": 15.0,
    "roundabout": 11.0,
    "intersection": 14.0,  # -5 to 9
    "u-turn": 10.0,
}


@dataclass(frozen=True, slots=True)
class Margin:
    """The largest acceptable |SUMO - highway-env|.

    Attributes:
        value: of the margin.
        relative_to: what `value` is a share of: nothing ("unit"), highway-env's own value ("reference"), or the range
            of the task's return ("range").
        reason: why so large.
    """

    value: float
    relative_to: Literal["unit", "reference", "range"]
    reason: str

    def bound(self, task: str, reference: float) -> float:
        """The margin in the unit of the measure, where highway-env's value is `reference`."""
        scale = {"unit": 1.0, "reference": abs(reference), "range": RETURN_RANGE[task]}
        return self.value * scale[self.relative_to]


MARGINS: dict[str, Margin] = {
    "traffic_speed": Margin(0.05, "reference", "the spread of desired speeds between drivers is 7 %"),
    "headway": Margin(
        0.15, "reference", "Wasserstein distance; traffic that brakes half or twice as hard is further away"
    ),
    "return": Margin(0.05, "range", "effects of training worth reporting are larger"),
    "crashed": Margin(0.10, "unit", "a dose of 1 is calibrated to raise the rate by 0.10 to 0.30"),
    "crashed_ego": Margin(0.15, "unit", "one ego meets one kind of conflict, all of them the mixture"),
    "lane_changes": Margin(
        0.25, "reference", "highway-env at 10 and at 15 Hz differs from itself by as much"
    ),
    "order": Margin(0.0, "unit", "which of two egos is better must not depend on the simulator"),
}
# The replica is highway-env compiled; an episode may differ only where rounding decides who crosses first.
REPLICA = Margin(0.01, "unit", "share of the recomputed episodes that end differently")


def margin_of(metric: str, task: str, traffic: str) -> Margin | None:
    """The margin of a measure, None where it is reported without a verdict."""
    if metric == "lane_changes" and (task != "highway" or traffic != "regular"):
        return None
    return MARGINS.get(metric)
