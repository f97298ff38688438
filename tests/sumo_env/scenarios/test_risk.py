"""What a dose of risk does to the drivers of SUMO's own files."""

from contextlib import ExitStack, closing, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sumo_env.config import ConfigError, warn_once
from sumo_env.env import DrivingEnv
from sumo_env.scenarios import NetworkTask, SumoDrivingEnv
from sumo_env.simulator import EgoCommand
from sumo_env.tasks.highway import Highway
from sumo_env.traffic.drivers import RISK_RANGES
from sumo_env.traffic.risk import EventKind, RiskRates
from tests.sumo_env.plans import build, needs_sumo, route_file

pytestmark = needs_sumo
PLAN = ("a 0 0, b 3000 0, c 4000 0", "ab a b 3 25, bc b c 3 25")
TYPES = """
    <vType id="car" accel="2.2" decel="4.4" tau="1.3" minGap="2.1"/>
    <vType id="lorry" vClass="truck" carFollowModel="IDM" accel="1.1" decel="3.3" tau="1.7" minGap="3.1"/>
    <vType id="wiedemann" carFollowModel="W99"/> <vType id="bike" vClass="bicycle"/>
    <vTypeDistribution id="mix" vTypes="car lorry" probabilities="0.7 0.3"/>
"""
FLOWS = """
    <flow id="f" type="mix" begin="0" end="900" probability="0.6" departLane="random"><route edges="ab bc"/></flow>
    <flow id="w" type="wiedemann" begin="0" end="900" period="40"><route edges="ab bc"/></flow>
    <flow id="b" type="bike" begin="0" end="900" period="40"><route edges="ab bc"/></flow>
"""
PARAMETERS = "accel", "decel", "tau", "min_gap", "assertive", "speed_gain"
OWN = {"car": (2.2, 4.4, 1.3, 2.1, 1.0, 1.0), "lorry": (1.1, 3.3, 1.7, 3.1, 1.0, 1.0)}


@pytest.fixture(scope="module")
def road(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    folder = tmp_path_factory.mktemp("road")
    return build(folder, PLAN), route_file(folder, TYPES + FLOWS)


def parameters(env: SumoDrivingEnv, names: tuple[str, ...]) -> dict[str, tuple[float, ...]]:
    """accel, decel, tau, minGap, lcAssertive and lcSpeedGain of vehicles, as SUMO has them."""
    ask = env.sumo.vehicle
    assert [ask.getApparentDecel(name) for name in names] == [ask.getDecel(name) for name in names]
    found: dict[str, tuple[float, ...]] = {}
    for name in names:
        changes = (ask.getParameter(name, f"laneChangeModel.{key}") for key in ("lcAssertive", "lcSpeedGain"))
        pedals = ask.getAccel(name), ask.getDecel(name), ask.getTau(name), ask.getMinGap(name)
        found[name] = *pedals, *map(float, changes)
    return found


def factors(env: SumoDrivingEnv) -> dict[str, np.ndarray]:
    """Of the vehicles on the road, relative to their own types."""
    cars = tuple(name for name in env.scene.ids[1:] if name.startswith("f."))
    kinds = {name: env.sumo.vehicle.getTypeID(name).partition("@")[0] for name in cars}
    return {name: np.array(values) / OWN[kinds[name]] for name, values in parameters(env, cars).items()}


def test_parameters_follow_the_law_relative_to_each_driver_s_own_type(road: tuple[Path, Path]) -> None:
    """200 vehicles read back from SUMO; a quantile is a driver's own, at every dose and in every episode."""
    found: dict[float, dict[str, np.ndarray]] = {}
    for dose in (1.0, 0.5):
        config = {"risk": dose, "warm_up": 150, "duration": 700, "simulation_frequency": 2}
        env = SumoDrivingEnv(*road, ["ab", "bc"], config)
        env.reset(seed=5)
        all_of = found[dose] = {}
        for _ in range(10):
            all_of.update(factors(env))
            simulator = env._car.episode.simulator
            for _ in range(25):
                env.scene = simulator.step({env.ego_id: EgoCommand(3.0, env.scene.place.lane)}).scene
    values = np.array(list(found[1.0].values()))
    assert len(values) >= 200
    for column, name in zip(values.T, PARAMETERS, strict=True):
        low, high = getattr(RISK_RANGES, name)
        assert low - 1e-3 <= column.min() < low + 0.05 and high - 0.05 < column.max() <= high + 1e-3
        assert column.mean() == pytest.approx((low + high) / 2, abs=0.07)
        assert column.std() == pytest.approx((high - low) / 12**0.5, abs=0.05)
    assert np.abs(np.corrcoef(values.T) - np.eye(6)).max() < 0.25
    both = found[1.0].keys() & found[0.5].keys()
    assert len(both) > 100
    for name in both:
        half, full = (found[0.5][name] - 1.0) * 2.0, found[1.0][name] - 1.0
        assert half[:4] == pytest.approx(full[:4], abs=1e-3)
        assert half == pytest.approx(full, abs=0.016)  # SUMO says those of lane changes with two digits


def test_bicycles_and_parameters_that_a_model_lacks_are_left_alone(road: tuple[Path, Path]) -> None:
    values = []
    warn_once.cache_clear()
    for dose in (0.0, 1.0):
        env = SumoDrivingEnv(*road, ["ab", "bc"], {"risk": dose, "warm_up": 90, "simulation_frequency": 5})
        with pytest.warns(UserWarning, match="no accel, decel, tau .* W99") if dose else nullcontext():
            env.reset(seed=5)
        names = tuple(name for name in env.scene.ids if name.startswith(("w.", "b.")))
        assert len(names) >= 4
        values.append(parameters(env, names))
        acted: set[str] = set()
        for _ in range(30):
            env.step(1)
            acted |= env.scene.in_event
        assert not any(name.startswith("b.") for name in acted)
        assert len(acted) > 3 if dose else not acted
    for name, before in values[0].items():
        assert values[1][name][:3] == before[:3]
        assert (values[1][name][3] == before[3]) == name.startswith("b.")


def crawl(**given: float) -> EventKind:
    """Drive at a walk: of a class that a worker cannot import, as those of a script."""

    @dataclass(frozen=True)
    class Crawl(EventKind):
        speed: float = 2.0

        def command(self, at: Any) -> None:
            at.vehicle.hold_speed()
            at.vehicle.drive(self.speed)

        def give_back(self, at: Any) -> None:
            at.vehicle.free_speed()

    return Crawl(**given)


class Crawling(NetworkTask):
    risk_rates = RiskRates()
    own_kinds = (crawl(rate=0.2, duration=3.0),)


def test_a_kind_of_a_user_s_own_acts_on_the_vehicles_of_files(road: tuple[Path, Path]) -> None:
    """In this process and in a worker, as often as its rate and the dose say; nothing at dose 0."""
    acted: list[list[set[str]]] = []
    with ExitStack() as opened:
        for dose in (0.0, 1.0, 1.0):  # those but the first in workers
            task = Crawling(*road, ["ab", "bc"])
            env = opened.enter_context(closing(DrivingEnv(task, {"risk": dose, "warm_up": 60})))
            acted.append([])
            env.reset(seed=5)
            for _ in range(8):
                names = {name for name in env.scene.ids if name in env.scene.in_event}
                assert all(env.sumo.vehicle.getSpeed(name) == pytest.approx(2.0) for name in names)
                acted[-1].append(names)
                env.step(4)
    assert not any(acted[0])
    assert acted[1] == acted[2]
    assert sum(map(len, acted[1])) > 10


@pytest.mark.parametrize("method", ["events", "vehicles", "spawns", "ego"])
def test_what_a_task_of_files_is_never_asked_is_an_error(road: tuple[Path, Path], method: str) -> None:
    task = type("Deaf", (NetworkTask,), {method: lambda *_: ()})
    with pytest.raises(ConfigError, match=f"Deaf.{method} is never asked"):
        task(*road, ["ab", "bc"])


def test_a_kind_without_a_rate_is_an_error() -> None:
    class Pressing(Highway):
        own_kinds = (crawl(duration=3.0),)

    with pytest.raises(ConfigError, match="rate"):
        DrivingEnv(Pressing()).reset(seed=0)


def test_nobody_cuts_in_where_a_lorry_is(tmp_path: Path) -> None:
    """Lorries of 16 m crawl nose to tail, and cars pass them in the lane beside."""
    lorry = '<vType id="lorry" vClass="truck" length="16" maxSpeed="0.05"/>'
    kinds = lorry + '<vType id="car" lcStrategic="-1" lcSpeedGain="0" lcKeepRight="0"/>'
    cars = kinds + '<route id="r" edges="ab bc"/>'
    stands, passes = 'departPos="{}"', 'departLane="1" departSpeed="10" arrivalLane="1"'
    car = '<vehicle id="{}" type="{}" route="r" depart="{}" {}/>'
    cars += "".join(car.format(f"l{k}", "lorry", 0, stands.format(20 + 19 * k)) for k in range(15))
    cars += "".join(car.format(f"c{k}", "car", 3 * k, passes) for k in range(1, 20))
    file = route_file(tmp_path, cars)
    net = build(tmp_path, ("a 0 0, b 340 0, c 700 0", "ab a b 2 14, bc b c 2 14"))
    env = SumoDrivingEnv(net, file, ego_vehicle="l14", config={"risk": 1.0, "duration": 60})
    env.reset(seed=0)
    reported = 0
    for _ in range(60):
        env.step(1)
        reported += env.sumo.simulation.getCollidingVehiclesNumber()
    assert not reported
