"""Traffic as a value: what drives around an agent in its training or in its test, in one table.

Unseen traffic is traffic that no agent was trained in: it tells an agent that is safer from one that has seen the risk
of its training. It is the traffic at dose 1 with something taken away or exchanged, on the same scenarios.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from agents.streams import stream
from experiments.study.design.sheet import task_of
from experiments.support.errors import check_known
from sumo_env.config import MEASURED
from sumo_env.tasks import TASKS
from sumo_env.traffic.risk import KINDS
from sumo_env.traffic.scenario import Scenario

REGULAR_DRIVERS = "regular"


@dataclass(frozen=True)
class Traffic:
    """What drives around an agent.

    dose: of risk; where it is drawn by the episode's seed, its mean. drawn: it is 0 or 1, by the episode's seed.
    events: the kind of risk events that there is alone, "" for none, None for all. drivers: None for those of the dose,
    "regular" for those of dose 0, "measured" for those of `sumo_env.traffic.measured`, or attributes of another
    car-following model of SUMO, for the drivers of the dose. without: a kind of risk event that there is not.
    """

    name: str
    dose: float
    drawn: bool = False
    events: str | None = None
    drivers: str | Mapping[str, Any] | None = None
    without: str | None = None

    @property
    def is_unseen(self) -> bool:
        """Whether it is traffic of a test alone."""
        return self.events is not None or self.drivers is not None

    @property
    def is_of_sumo(self) -> bool:
        """Whether only SUMO has its drivers."""
        return self.drivers not in (None, REGULAR_DRIVERS)

    def dose_of(self, seed: int) -> float:
        """Dose of risk in the episode with this seed; it depends on the seed alone."""
        if not self.drawn:
            return self.dose
        return float(stream(seed, "dose").random() < 0.5)

    def options(self, seed: int) -> dict[str, Any]:
        """What `reset` is asked for in the episode with this seed; unseen traffic is also a `scenario` of its own."""
        rates = {"risk_rates": {self.without.replace("-", "_"): 0.0}} if self.without else {}
        return {"config": {"risk": self.dose_of(seed)}, **rates}

    def scenario(self, regular: Scenario, risky: Scenario) -> Scenario:
        """The scenario of unseen traffic, from those of one seed at dose 0 and 1."""
        if self.drivers == MEASURED:
            return TASKS[regular.task].measured.driving(regular)
        if self.drivers == REGULAR_DRIVERS:
            events = tuple(event for event in risky.events if event.kind == self.events)
            return replace(regular, events=events)
        if self.drivers is None:
            return replace(risky, events=())
        model: Any = self.drivers
        return risky.with_drivers(lambda driver: driver.like(self.name, model))


# SUMO would draw the random errors of its other models from its own generator, and an episode would depend on those
# before it: they are off.
KRAUSS = {"carFollowModel": "Krauss", "sigma": 0}
EIDM = {"carFollowModel": "EIDM", "sigmaerror": 0, "sigmaleader": 0, "sigmagap": 0}
WITHOUT = {f"no-{kind}": Traffic(f"no-{kind}", 1.0, without=kind) for kind in ("cut-in", "brake")}
ALL: dict[str, Traffic] = {
    traffic.name: traffic
    for traffic in (
        Traffic("regular", 0.0),
        Traffic("dose25", 0.25),
        Traffic("dose50", 0.5),
        Traffic("dose75", 0.75),
        Traffic("risky", 1.0),
        Traffic("mixed", 0.5, drawn=True),
        *(Traffic(f"only-{kind}", 1.0, events=kind, drivers=REGULAR_DRIVERS) for kind in KINDS),
        Traffic("only-parameters", 1.0, events=""),
        Traffic("krauss", 1.0, drivers=KRAUSS),
        Traffic("eidm", 1.0, drivers=EIDM),
        Traffic(MEASURED, 0.0, drivers=MEASURED),
        *WITHOUT.values(),
    )
}
TRAFFICS = ("regular", "risky")  # what every agent is tested in
UNSEEN = tuple(name for name, traffic in ALL.items() if traffic.is_unseen)
AT_A_DOSE = {name: one.dose for name, one in ALL.items() if not (one.drawn or one.is_unseen or one.without)}
BETWEEN = tuple(name for name in AT_A_DOSE if name not in TRAFFICS)  # doses between 0 and 1


def traffic_named(name: str) -> Traffic:
    """The traffic of this name. Raises UserError where there is none."""
    check_known("traffic", [name], ALL)
    return ALL[name]


def unseen_traffics(task: str, backend: str = "sumo") -> tuple[str, ...]:
    """The traffics of UNSEEN that differ from regular and risky traffic in a task, on a backend.

    Kinds of events that the task does not have are skipped, and SUMO's models on other simulators. Measured drivers are
    no part of the risk, and younger than the published tests: they are asked for by name.
    """
    rates = TASKS[task_of(task)].risk_rates

    def differs(one: Traffic) -> bool:
        if one.drivers == MEASURED:
            return False
        if one.is_of_sumo:
            return backend == "sumo"
        kinds = [one.events] if one.events else KINDS
        return any(getattr(rates, kind.replace("-", "_")) > 0 for kind in kinds)

    return tuple(name for name in UNSEEN if differs(ALL[name]))
