"""Importance sampling of risk events: those near learning cars come so many times as often (docs/rare.md).

Events are Poisson processes of known rates, so that the likelihood ratio of an episode is exact. The events of the
scenario stay as they are. Further ones are drawn in advance, from random streams of their own, and come only while
their vehicle is near: together they have the rate that is asked for, whatever the learning cars do.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import inf, log
from typing import Any

from sumo_env.config import ConfigError
from sumo_env.traffic.risk import RATES, RiskEvent, RiskRates, draw_events

TILTED = ("event_factor", "event_reach")  # the options of `reset`
MOST = 1000.0  # [1/s] events of a vehicle: more would fill the memory


@dataclass(frozen=True, slots=True)
class Tilt:
    """How much more often events of vehicles near learning cars come in an episode.

    In each policy step those vehicles are near that are within `reach` of a learning car at its start.

    Raises:
        ConfigError: a factor or reach that makes no sense, or no events at all.
    """

    factor: float  # times as often, from 1 on
    reach: float  # from centre to centre [m]
    rates: RiskRates  # of the events at factor 1
    dose: float  # likewise
    duration: float  # of the episode [s], after which no event begins

    def __post_init__(self) -> None:
        if not 1.0 <= self.factor < inf or self.factor * self.rate > MOST:
            raise ConfigError(
                f"options['event_factor'] must be a number from 1 on, with which a vehicle has at most {MOST:g} events "
                f"a second (it has {self.rate:g} at factor 1), not {self.factor!r}"
            )
        if not self.reach > 0.0:
            raise ConfigError(f"options['event_reach'] must be above 0 m, or infinite, not {self.reach!r}")
        if self.dose == 0.0:
            raise ConfigError(
                "options['event_factor'] has no effect at risk 0: set the config key 'risk' too"
            )

    @property
    def rate(self) -> float:
        """Events of a vehicle at factor 1 [1/s]."""
        return self.dose * sum(getattr(self.rates, name) for name in RATES)

    def further(
        self, vehicles: tuple[tuple[str, float], ...], seed: int, purpose: str = "further risk events"
    ) -> tuple[RiskEvent, ...]:
        """Events beside those at factor 1, which come only near learning cars; arguments as of `draw_events`."""
        scale = (self.factor - 1.0) * self.dose
        rates = replace(self.rates, **{name: scale * getattr(self.rates, name) for name in RATES})
        drawn = draw_events(rates, 1.0, vehicles, seed, self.duration, purpose)
        return tuple(replace(event, is_further=True) for event in drawn)

    def log_weight(self, events: int, expected: float) -> float:
        """Logarithm of the likelihood at factor 1 over that at this factor.

        Args:
            events: that have come near learning cars.
            expected: mean number of these at factor 1, given who was near.
        """
        return (self.factor - 1.0) * expected - events * log(self.factor)


def asked_tilt(options: Mapping[str, Any], rates: RiskRates, dose: float, duration: float) -> Tilt | None:
    """What options of `reset` ask for; None without them. Raises ConfigError for wrong ones."""
    given = [options[name] for name in TILTED if name in options]
    if not given:
        return None
    if len(given) < len(TILTED) or not all(
        isinstance(one, int | float) and not isinstance(one, bool) for one in given
    ):
        raise ConfigError(
            "options['event_factor'] and options['event_reach'] [m] are given together, as numbers: not "
            f"{ {name: options[name] for name in TILTED if name in options} }"
        )
    return Tilt(float(given[0]), float(given[1]), rates, dose, duration)
