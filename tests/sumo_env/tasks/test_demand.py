"""Route files: what departs when, and what is left to chance."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from sumo_env.config import ConfigError
from sumo_env.tasks import demand

TYPES = """
    <vType id="slow" maxSpeed="10" speedFactor="0.8" color="red"/>
    <vType id="mixed" accel="2" speedFactor="normc(1,0.1,0.7,1.3)"/>
    <route id="r" edges="x y"/>
"""


def entries(tmp_path: Path, elements: str) -> tuple[demand.Entry, ...]:
    file = tmp_path / "d.rou.xml"
    file.write_text(f"<routes>{TYPES}{elements}</routes>")
    return demand.read(file, lambda start, end, via, _: (start, *via, end))[1]


def departures(tmp_path: Path, element: str, end: float = 100.0, seed: int = 0) -> list[tuple[str, float]]:
    (entry,) = entries(tmp_path, element)
    return list(entry.departures(np.random.default_rng(seed), 0.0, end))


def test_times_positions_and_lanes(tmp_path: Path) -> None:
    vehicle = '<vehicle id="v" route="r" depart="0:01:10" departLane="1" departPos="7"/>'
    (one,) = entries(tmp_path, vehicle)
    assert (one.route, one.lane, one.front, one.kind) == ("r", 1, 7.0, None)
    assert departures(tmp_path, vehicle) == [("v", 70.0)]
    flow = departures(tmp_path, '<flow id="f" route="r" period="30" end="100"/>')
    assert flow == [("f.0", 0.0), ("f.1", 30.0), ("f.2", 60.0), ("f.3", 90.0)]


@pytest.mark.parametrize("gaps", ['period="exp(0.5)"', 'probability="0.5"'])
def test_flows_by_chance_are_drawn_from_the_seed(tmp_path: Path, gaps: str) -> None:
    flow = f'<flow id="f" route="r" begin="20" end="420" {gaps}/>'
    times = [time for _, time in departures(tmp_path, flow, 1000.0)]
    assert len(times) == pytest.approx(200, abs=40)  # one in two seconds
    assert min(times) > 20 and max(times) <= 420
    assert times == [time for _, time in departures(tmp_path, flow, 1000.0)]
    assert times != [time for _, time in departures(tmp_path, flow, 1000.0, seed=1)]


def test_trips_are_routed(tmp_path: Path) -> None:
    file = tmp_path / "d.rou.xml"
    file.write_text('<routes><trip id="t" from="x" to="z" via="y" depart="3"/></routes>')
    routes, (entry,) = demand.read(file, lambda start, end, via, _: (start, *via, end))
    assert routes[entry.route] == ("x", "y", "z")


def test_the_wish_for_speed(tmp_path: Path) -> None:
    slow, mixed, own = (
        one.kind
        for one in entries(
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
    truck, bus = (one.kind for one in entries(tmp_path, kinds + vehicles))
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
