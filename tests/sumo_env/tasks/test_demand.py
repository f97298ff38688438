"""Route files: what departs when, and what is left to chance."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from sumo_env.config import ConfigError
from sumo_env.tasks import demand
from tests.sumo_env.plans import route_file

TYPES = """
    <vType id="slow" maxSpeed="10" speedFactor="0.8" color="red"/>
    <vType id="mixed" accel="2" speedFactor="normc(1,0.1,0.7,1.3)"/>
    <vTypeDistribution id="both" vTypes="slow mixed" probabilities="0.25 0.75"/>
    <vTypeDistribution id="own"><vType id="a" accel="1"/><vType id="b" accel="2" probability="3"/></vTypeDistribution>
    <route id="r" edges="x y"/> <route id="s" edges="x z"/>
    <routeDistribution id="either" routes="r s" probabilities="1 3"/>
"""


def departures(tmp_path: Path, elements: str, end: float = 100.0, seed: int = 0) -> list[demand.Departure]:
    file = route_file(tmp_path, TYPES + elements)
    _, entries = demand.read(file, lambda start, end, via, _: (start, *via, end))
    rng = np.random.default_rng(seed)
    return [one for entry in entries for one in entry.departures(rng, 0.0, end)]


def test_times_positions_and_lanes(tmp_path: Path) -> None:
    (one,) = departures(tmp_path, '<vehicle id="v" route="r" depart="0:01:10" departLane="1" departPos="7"/>')
    assert (one.id, one.route, one.time, one.lane, one.front, one.kind) == ("v", "r", 70.0, 1, 7.0, None)
    flow = departures(tmp_path, '<flow id="f" route="r" period="30" end="100"/>')
    assert [one.id for one in flow] == ["f.0", "f.1", "f.2", "f.3"]


@pytest.mark.parametrize("gaps", ['period="exp(0.5)"', 'probability="0.5"'])
def test_flows_by_chance_are_drawn_from_the_seed(tmp_path: Path, gaps: str) -> None:
    flow = f'<flow id="f" route="r" begin="20" end="420" {gaps}/>'
    times = [one.time for one in departures(tmp_path, flow, 1000.0)]
    assert len(times) == pytest.approx(200, abs=40)  # one in two seconds
    assert min(times) > 20 and max(times) <= 420
    assert times == [one.time for one in departures(tmp_path, flow, 1000.0)]
    assert times != [one.time for one in departures(tmp_path, flow, 1000.0, seed=1)]


def test_distributions_of_types_and_routes(tmp_path: Path) -> None:
    found = departures(tmp_path, '<flow id="f" type="both" route="either" period="1" end="1000"/>', 1000.0)
    assert sum(one.route == "s" for one in found) == pytest.approx(750, abs=50)
    assert sum(one.kind.name == "slow" for one in found) == pytest.approx(250, abs=50)
    found = departures(tmp_path, '<flow id="f" type="own" route="r" period="1" end="1000"/>', 1000.0)
    assert sum(one.kind.name == "b" for one in found) == pytest.approx(750, abs=50)


def test_trips_are_routed(tmp_path: Path) -> None:
    file = route_file(tmp_path, '<trip id="t" from="x" to="z" via="y" depart="3"/>')
    routes, (entry,) = demand.read(file, lambda start, end, via, _: (start, *via, end))
    assert routes[entry.routes[0][0]] == ("x", "y", "z")


def test_the_wish_for_speed(tmp_path: Path) -> None:
    slow, mixed, own = (
        one.kind
        for one in departures(
            tmp_path,
            '<vehicle id="1" type="slow" route="r" depart="0"/><vehicle id="2" type="mixed" route="r" depart="0"/>'
            '<vehicle id="3" type="slow" speedFactor="0.5" route="r" depart="0"/>',
        )
    )
    rng = np.random.default_rng(0)
    assert slow.factor(rng) == 0.8 and slow.attributes == {"maxSpeed": "10"}
    factors = [mixed.factor(rng) for _ in range(500)]
    assert (np.mean(factors), np.std(factors)) == pytest.approx((1.0, 0.1), abs=0.02)
    assert min(factors) >= 0.7 and max(factors) <= 1.3
    assert own.factor(rng) == 0.5


def test_classes_say_size_and_power(tmp_path: Path) -> None:
    kinds = '<vType id="t" vClass="truck" guiShape="truck"/><vType id="b" vClass="bus" length="18"/>'
    vehicles = "".join(f'<vehicle id="{k}" type="{k}" route="r" depart="0"/>' for k in "tb")
    truck, bus = (one.kind for one in departures(tmp_path, kinds + vehicles))
    assert (truck.attributes["length"], truck.attributes["accel"]) == ("7.1", "1.3")
    assert bus.attributes["length"] == "18"
    with pytest.raises(ConfigError, match="vehicles of class 'rail' cannot"):
        departures(tmp_path, '<vType id="x" vClass="rail"/>')
    with pytest.raises(ConfigError, match="did you mean 'accel'"):
        departures(tmp_path, '<vType id="x" acell="2"/>')


def test_what_has_no_effect_is_said(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    with pytest.warns(UserWarning, match="arrivalPos of a vehicle"):
        departures(tmp_path, '<vehicle id="v" route="r" depart="0" arrivalPos="3"/>')
    with pytest.warns(UserWarning, match="<param> of a vehicle"):
        departures(tmp_path, '<vehicle id="v" route="r" depart="0"><param key="k" value="v"/></vehicle>')
