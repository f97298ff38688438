"""What is refused of SUMO's own files: a row is what a user gives, the type of the error, and the word to act on."""

import os
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sumo_env import parallel_env
from sumo_env.config import ConfigError, warn_once
from sumo_env.env import DrivingEnv
from sumo_env.scenarios import SumoDrivingEnv
from sumo_env.simulator import SimulatorError
from sumo_env.tasks import TASKS
from tests.sumo_env.plans import grid, needs_sumo, route_file
from tests.sumo_env.scenarios.files import written

pytestmark = [needs_sumo, pytest.mark.filterwarnings("ignore")]
WAY = ["A0A1", "A1B1", "B1C1", "C1C2"]
CONFIG, NET, ROUTES = "t.sumocfg", "grid.net.xml", "t.rou.xml"
WALK = '<person id="walker" depart="9"><walk from="A0A1" to="A1B1"/></person>'
MIX = '<vType id="quick"/><vTypeDistribution id="mix" vTypes="quick"/>'
# Files that are another one with one text in place of another.
CHANGED: dict[str, tuple[str, str, str]] = {
    "meso.sumocfg": (CONFIG, "</input>", '</input><mesosim value="true"/>'),
    "connects.sumocfg": (CONFIG, "trips.xml", "localhost:8000"),
    "collisions.sumocfg": (CONFIG, "<time>", '<time><collision.action value="remove"/>'),
    "vtk.sumocfg": (CONFIG, "<time>", '<time><vtk-output value="/nowhere/precious"/>'),
    "twice.sumocfg": (CONFIG, "<time>", '<time><n value="grid.net.xml"/><begin value="3"/><b value="5"/>'),
    "shift.sumocfg": (CONFIG, "<configuration>", "<?xml version='1.0' encoding='shift_jis'?><configuration>"),
    "ufo.rou.xml": (ROUTES, "<routes>", "<?xml version='1.0' encoding='ufo'?><routes>"),
    "people.rou.xml": (ROUTES, "</routes>", f"{WALK}</routes>"),
    "no.net.xml": (NET, ' fromLane="0"', ' fromLane="-1"'),
    "none.net.xml": (NET, "<location ", '<edge id="q" from="A0" to="A1"/><location '),
    "mix.add.xml": ("t.add.xml", "<additional>", f"<additional>{MIX}"),
}  # fmt: skip


@pytest.fixture(scope="module")
def town(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = written(tmp_path_factory.mktemp("town"), "static").parent
    for name, (origin, old, new) in CHANGED.items():
        text = (folder / origin).read_text()
        assert old in text, name
        (folder / name).write_text(text.replace(old, new))
    os.mkfifo(folder / "pipe.xml")
    (folder / "bare").mkdir()
    grid(folder / "bare", "--no-internal-links")
    return folder


def ego(network: str = CONFIG, **more: Any) -> dict[str, Any]:
    """The arguments of the car that the files call "ego"."""
    return {"network": network, "ego_vehicle": "ego", **more}


def own(**more: Any) -> dict[str, Any]:
    """The arguments of a car on the network, which the files do not have."""
    return {"network": NET, "routes": [WAY], "ego_route": WAY, **more}


ROWS: list[tuple[dict[str, Any], type[Exception], str]] = [
    (ego(ego_vehicle="wst.0"), ConfigError, "did you mean"),
    (ego(ego_vehicle="taxi7"), ConfigError, "they have east.0, ego, "),
    (ego(ego_vehicle="west"), ConfigError, "west is a flow: its vehicles are named west.0, west.1, ..."),
    (ego(ego_vehicle=None), ConfigError, "exactly one of ego_route, ego_trips, ego_vehicle; you gave none"),
    (ego(ego_trips=[["A0A1", "C2C1"]]), ConfigError, "you gave both ego_trips and ego_vehicle"),
    (ego(ego_type="DEFAULT_VEHTYPE"), ConfigError, "is added"),
    (ego(config={"initial_speed": "max"}), ConfigError, "'initial_speed'"),
    (ego(config={"traffic_scale": 2}), ConfigError, "2 numbers"),
    (ego(config={"traffic_scale": [0.5, 1]}), ConfigError, "leave out an ego"),
    (ego(sumo_options=["--mesosim"]), ConfigError, "the environment's own"),
    (ego(ego_vehicle="west.20", config={"wait": 5}), SimulatorError, "car (west.20) has not departed"),
    (ego(config={"warm_up": 200}), SimulatorError, "'warm_up'"),
    (own(network=CONFIG, routes=[], config={"traffic_scale": [2, 1]}), ConfigError, "traffic_scale"),
    (own(network=CONFIG, routes=[], sumo_options=["--begin=5"]), ConfigError, "begin"),
    (own(ego_type="lorry9"), SimulatorError, "lorry9"),
    (own(ego_route="A0A1"), ConfigError, "list of edges"),
    (own(routes={"duration": 9}), ConfigError, "route duration"),
    (own(network=None), ConfigError, "a file"),
    (ego(ego_vehicle=0), ConfigError, "'0'"),
    (own(ego_route=["A0A9"]), ConfigError, "edge 'A0A9'"),
    (own(ego_route=[["A0A1", "C1C2"]]), ConfigError, "no connection leads from edge 'A0A1'"),
    (own(ego_route=None, ego_trips=["A0A1"]), ConfigError, "pairs of edges"),
    (own(ego_route=None, ego_trips=[["A0A1", "B9"]]), ConfigError, "edge 'B9'"),
    (own(routes=[["A0A1", "B1B2"]]), ConfigError, "route 0"),
    (own(routes={"r": "A0A1 A1B1"}), ConfigError, "route r"),
    # files
    (own(network="nowhere.net.xml"), ConfigError, "no file"),
    (own(network=ROUTES), ConfigError, "no edges"),
    (own(network="bare/grid.net.xml"), ConfigError, "no-internal-links"),
    (own(routes=NET), ConfigError, "is a network"),
    (own(routes="ufo.rou.xml"), ConfigError, "ufo.rou.xml"),
    (own(network="no.net.xml"), ConfigError, "no.net.xml"),
    (own(network="none.net.xml"), ConfigError, "none.net.xml"),
    (ego("shift.sumocfg"), ConfigError, "shift.sumocfg cannot be read"),
    (ego("meso.sumocfg"), ConfigError, "'mesosim'"),
    (ego("twice.sumocfg"), ConfigError, "'begin' is given twice"),
    (ego("connects.sumocfg", output_dir="out"), ConfigError, "opens a connection"),
    (ego("vtk.sumocfg", output_dir="out"), ConfigError, "output_dir"),
    # a pipe is not waited for
    *((own(**{argument: "pipe.xml"}), ConfigError, "no file") for argument in ("network", "routes", "additional")),
]  # fmt: skip
FLEETS: list[tuple[dict[str, Any], str]] = [
    ({}, "vehicles=[ids]"),
    ({"vehicles": "ego"}, "list of names"),
    ({"vehicles": ["ego", "ego"]}, "different"),
    ({"vehicle_type": "mix", "max_cars": 2, "additional": "mix.add.xml"}, "distribution"),
    *(({"vehicle_type": "ego", "max_cars": most}, "'max_cars' must be a whole") for most in (0, "2")),
    ({"vehicle_type": "quikc", "max_cars": 2, "additional": "mix.add.xml"}, "quick"),
]


@pytest.mark.parametrize(("given", "error", "word"), ROWS, ids=str)
def test_an_environment_is_refused(town: Path, monkeypatch, given, error: type[Exception], word: str) -> None:
    monkeypatch.chdir(town)
    with pytest.raises(error) as caught:
        SumoDrivingEnv(**given).reset(seed=0)
    assert word in str(caught.value)


@pytest.mark.parametrize(("given", "word"), FLEETS, ids=str)
def test_a_fleet_is_refused(town: Path, monkeypatch, given: dict[str, Any], word: str) -> None:
    monkeypatch.chdir(town)
    with pytest.raises(ConfigError) as caught:
        parallel_env(NET, routes=ROUTES, **given)
    assert word in str(caught.value)


WARNED: list[tuple[list[dict[str, Any]], str]] = [
    ([own(routes="people.rou.xml")], "on foot"),
    ([ego(config={"vehicles_count": 30})], "use 'traffic_scale'"),
    ([ego(config={"simulation_frequency": 300})], "milliseconds.*-10%"),
    ([ego("collisions.sumocfg")], "collision.action=remove is replaced by warn"),
    ([ego(), ego()], "read the first one"),
]


@pytest.mark.parametrize(("given", "word"), WARNED, ids=str)
def test_what_differs_from_what_one_would_think_is_said(town: Path, monkeypatch, given, word: str) -> None:
    """When environments are made or at their first reset."""
    monkeypatch.chdir(town)
    warn_once.cache_clear()
    with pytest.warns(UserWarning, match=word):
        envs = [SumoDrivingEnv(**one) for one in given]
        for env in envs:
            env.reset(seed=0)
    for env in envs:
        env.close()


# -- numbers -------------------------------------------------------------------------------------------------------

ODD = (0, -1, 1e9, 1e308)


def odd_values(value: Any) -> list[Any]:
    """Other numbers in place of a number, or of those of a list; none in place of anything else."""
    several = value if isinstance(value, list) else [value]
    if not several or not all(isinstance(one, int | float) and not isinstance(one, bool) for one in several):
        return []
    return [[*(len(value) - 1) * [0.0], odd] for odd in ODD] if value is several else list(ODD)


@pytest.mark.parametrize("task", ["network", *(pytest.param(task, marks=pytest.mark.long) for task in TASKS)])
def test_every_number_of_a_configuration_is_refused_or_gives_finite_numbers(task: str, tmp_path) -> None:
    net = grid(tmp_path, "--grid.number=2", "--grid.length=100", "-L=2")
    flow = '<flow id="f" begin="0" end="60" period="3" from="A0A1" to="B1B0"/>'
    own: dict[str, Any] = {"routes": route_file(tmp_path, flow), "ego_trips": [("A0A1", "B1B0")]}
    taken = 0
    with closing(SumoDrivingEnv(net, **own) if task == "network" else DrivingEnv(task)) as env:
        usual = {key: value for key, value in env.config.items() if odd_values(value)}
        usual["reward_speed_range"] = [0, 1]
        weights = [key for key in usual if key.endswith("_reward")]  # all at once
        changes = [dict.fromkeys(weights, odd) for odd in ODD]
        changes += [{key: odd} for key in usual.keys() - weights for odd in odd_values(usual[key])]
        for change in changes:
            try:
                env.configure({**usual, **change})
                env.reset(seed=0)
            except (ConfigError, SimulatorError) as error:
                assert "\n" not in str(error), change
                continue
            for action in (1, 0):
                seen, reward, *_, info = env.step(action)
                assert np.isfinite([reward, *info["rewards"].values()]).all(), change
                assert np.isfinite(seen).all(), change
            taken += 1
    assert taken > 10
