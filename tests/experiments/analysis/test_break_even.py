"""Where risky training breaks even, from curves whose crossing is known."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from experiments.analysis.break_even import break_even, compared, mean_of_agents
from experiments.reporting.rare import break_even_figure, break_even_words

RATES = [1e-3, 1e-2, 1e-1, 1.0]


def agent(values: np.ndarray, width: float = 0.1) -> pd.DataFrame:
    """The curve of an agent whose intervals are so wide, as a share."""
    parts = {"crashes_per_episode": values, "crashes_per_100_km": 500 * values}
    ends = {f"{name}_low": (1 - width) * value for name, value in parts.items()}
    ends |= {f"{name}_high": (1 + width) * value for name, value in parts.items()}
    return pd.DataFrame({"rate": RATES, **parts, **ends})


def arm(floor: float, slope: float, spread: float = 0.01) -> list[pd.DataFrame]:
    return [agent((1 + spread * k) * (floor + slope * np.array(RATES))) for k in (-2, -1, 0, 1, 2)]


def test_the_curves_cross_where_they_are_known_to() -> None:
    """0.01 + 0.5 r and 0.02 + 0.1 r are equal at 0.025; the rate is interpolated on its logarithm."""
    found = break_even(compared({"control": arm(0.01, 0.5), "treatment": arm(0.02, 0.1)}))
    assert found.low <= 0.025 <= found.high
    # the differences of the arms at the rates between which it lies are .006 and -.03
    assert found.rate == pytest.approx(0.01 * 10 ** (0.006 / 0.036))
    assert found.less == (0.1, 1.0) and found.more[0] == 1e-3
    assert break_even_words(found, 1000.0, RATES).startswith("treated agents crash in fewer episodes above")
    swapped = break_even(compared({"control": arm(0.02, 0.1), "treatment": arm(0.01, 0.5)}))
    assert swapped.rate == pytest.approx(found.rate) and swapped.less == found.more
    assert "in more episodes above" in break_even_words(swapped, 1000.0, RATES)


def test_what_is_not_decided_is_not_said() -> None:
    below = break_even(compared({"control": arm(0.01, 0.5, 0.1), "treatment": arm(0.01, 0.1, 0.1)}))
    assert np.isnan(below.rate) and np.isnan(below.more[0]) and below.less == (0.01, 1.0)
    words = break_even_words(below, 1000.0, RATES)
    assert "from 10 to 1,000 events" in words and "more" not in words and "no rate breaks even" in words
    always = break_even(compared({"control": arm(0.02, 0.5), "treatment": arm(0.01, 0.1)}))
    assert break_even_words(always, 1000.0, RATES).endswith(
        "from 1 to 1,000 events per vehicle-hour, all that were asked about"
    )
    same = compared({"control": arm(0.01, 0.5, 0.1), "treatment": arm(0.01, 0.5, 0.1)})
    assert break_even_words(break_even(same), 1.0, RATES) == "nothing is decided at any rate"


def test_agents_have_student_s_interval_or_that_of_their_episodes() -> None:
    none = agent(np.zeros(4)).assign(crashes_per_episode_high=0.004)
    found = mean_of_agents([none] * 4, "episode")
    np.testing.assert_allclose(found, np.tile([0.0, 0.0, 0.004 / 2], (4, 1)))
    exact = mean_of_agents([agent(np.full(4, value), 0.0) for value in (0.1, 0.2, 0.6)], "episode")
    np.testing.assert_allclose(exact, np.tile([0.3, 0.0, 0.3 + 4.3027 * 0.2646 / 3**0.5], (4, 1)), atol=1e-4)


def test_the_interval_covers_the_difference_of_two_populations() -> None:
    """Each rate of the curves is another study."""
    rng, studies, curves = np.random.default_rng(1), 400, {}
    for name, centre in (("control", 0.3), ("treatment", 0.1)):
        rates = np.clip(rng.normal(centre, 0.03, (5, studies)), 0.01, 0.99)  # agents differ
        seen = rng.binomial(400, rates) / 400
        half = 1.96 * np.sqrt(seen * (1 - seen) / 400)
        parts = {"": seen, "_low": seen - half, "_high": seen + half}
        curves[name] = [
            pd.DataFrame(
                {
                    "rate": np.arange(studies),
                    **{f"crashes_per_episode{end}": of[k] for end, of in parts.items()},
                }
            )
            for k in range(5)
        ]
    found = compared(curves)
    assert len(found) == studies
    assert 0.93 <= found.eval("difference_low <= -0.2 <= difference_high").mean() <= 0.99


def test_the_figure_has_a_panel_for_each_task() -> None:
    both = compared({"control": arm(0.01, 0.5), "treatment": arm(0.02, 0.1)}).add_suffix("_per_episode")
    table = both.reset_index().assign(events_per_hour=1000 * np.array(RATES))
    drawn = break_even_figure(pd.concat([table.assign(task=task) for task in ("u-turn", "roundabout")]))
    assert "u-turn" in drawn and "roundabout" in drawn and "near-crashes" in drawn
