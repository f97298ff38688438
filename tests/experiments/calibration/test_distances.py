"""What calibration makes small."""

from __future__ import annotations

import pandas as pd
import pytest

from experiments.calibration import objectives
from experiments.validation.checks import REFERENCE
from tests.experiments.validation.tables import compared, episodes


def test_traffic_that_is_the_same_has_no_distance() -> None:
    assert objectives.drivers(compared(), "sumo", "u-turn") == pytest.approx(0.0)


def test_distance_grows_with_the_difference() -> None:
    near, far = (
        objectives.drivers(compared(traffic_speed=speed), "sumo", "u-turn") for speed in (10.3, 12.0)
    )
    assert 0.0 < near < far


def responses(engine: str, careful: tuple[float, float, float]) -> pd.DataFrame:
    """Episodes in which the careful ego crashes at these rates at the three doses, the others always."""
    parts = []
    for traffic, rate in zip(objectives.SEARCHED, careful, strict=True):

        def crashed(ego: str, scenario: int, rate: float = rate) -> bool:
            return scenario < 40 * rate if ego == "careful" else True

        parts.append(episodes(engine, traffic=traffic, crashed=crashed))
    return pd.concat(parts)


@pytest.mark.parametrize(
    ("sumo", "reference", "good"),
    [
        ((0.0, 0.1, 0.2), (0.0, 0.1, 0.2), True),
        ((0.0, 0.1, 0.2), (0.2, 0.3, 0.4), False),  # the simulators differ
        ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), False),  # the dose does nothing
        ((0.0, 0.5, 0.9), (0.0, 0.5, 0.9), False),  # the dose does too much
        ((0.0, 0.3, 0.2), (0.0, 0.3, 0.2), False),  # a smaller dose does more
    ],
)
def test_a_dose_does_what_it_shall(sumo, reference, good) -> None:
    table = pd.concat([responses("sumo", sumo), responses(REFERENCE, reference)])
    assert (objectives.doses(table, "sumo", "u-turn") < 0.01) is good


def test_responses_are_by_simulator_dose_and_ego() -> None:
    found = objectives.responses(responses("sumo", (0.0, 0.1, 0.2)))
    rows = found[found["ego"] == "careful"]
    assert dict(zip(rows["traffic"], rows["crash_rate"], strict=True)) == pytest.approx(
        {"regular": 0.0, "0.5": 0.1, "risky": 0.2}
    )
