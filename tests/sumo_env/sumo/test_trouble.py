"""libsumo used behind the environment's back: an error that says so, or an episode that goes on; never a dead process.

The misuses run in a process of their own, because the wrong outcome is the end of that process.
"""

import json
import os
import signal
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sumo_env.env import DrivingEnv
from sumo_env.scenarios import SumoDrivingEnv
from sumo_env.simulator import SimulatorError
from sumo_env.sumo.process import SumoProcess
from sumo_env.sumo.session import Session
from tests.processes import ended
from tests.sumo_env import plans
from tests.sumo_env.plans import needs_sumo
from tests.sumo_env.rollout import drive
from tests.sumo_env.scenarios import files

SCRIPT = """
import json, sys
import libsumo
import numpy as np
from sumo_env.env import DrivingEnv
from sumo_env.networks.mapping import network
from sumo_env.networks.roads import road
from sumo_env.simulator import SimulatorError
from sumo_env.sumo.world import SumoSimulator

misuses, state = json.loads(sys.argv[1]), sys.argv[2]
other = network(road("u-turn")).net_file

def drive(env, seed):
    rows = [env.reset(seed=seed)[0]]
    for _ in range(3):
        observation, _, terminated, truncated, _ = env.step(1)
        rows.append(observation)
        if terminated or truncated:
            break
    return np.array(rows)

def begin(env):
    env.reset(seed=1)
    env.step(1)
    return {"env": env, "state": state, "other": other, "libsumo": libsumo, "names": env.scene.ids}

for code in misuses:
    env = DrivingEnv("intersection", {"risk": 1.0}, simulator=SumoSimulator())
    expected = drive(env, 5)
    exec(code, begin(env))
    np.testing.assert_array_equal(drive(env, 5), expected, err_msg=code)
    exec(code, begin(env))
    outcome = "went on"
    try:
        for _ in range(3):
            env.step(1)
    except SimulatorError as error:
        assert "reset()" in str(error), error
        outcome = "SimulatorError"
    for _ in range(2):
        np.testing.assert_array_equal(drive(env, 5), expected, err_msg=code)
    env.close()
    print(outcome, flush=True)
"""

RAISES, EITHER = ("SimulatorError",), ("SimulatorError", "went on")
MISUSES = {
    "remove another": ("libsumo.vehicle.remove(names[1])", ("went on",)),
    "remove all": ("for name in names: libsumo.vehicle.remove(name)", RAISES),
    "close": ("libsumo.close()", RAISES),
    "load another road": ("libsumo.load(['-n', str(other), '--no-step-log'])", RAISES),
    "load an earlier episode's state": (
        "libsumo.simulation.saveState(state); env.reset(seed=2); libsumo.simulation.loadState(state)",
        RAISES,
    ),
    "step far": ("libsumo.simulationStep(1000.0)", RAISES),
    "add": ("libsumo.vehicle.add('mine', libsumo.route.getIDList()[0]); libsumo.simulationStep()", EITHER),
    "subscribe": (
        "libsumo.vehicle.subscribeContext('ego', libsumo.CMD_GET_VEHICLE_VARIABLE, 100.0)",
        ("went on",),
    ),
}


def test_the_next_reset_works_whatever_was_done_to_libsumo(tmp_path: Path) -> None:
    """Reset at once, and after the error or the steps that follow."""
    codes, allowed = zip(*MISUSES.values(), strict=True)
    done = ended("-c", SCRIPT, json.dumps(codes), tmp_path / "state.xml")
    said = [line for line in done.stdout.splitlines() if line in EITHER]
    found = dict(zip(MISUSES, said, strict=False))  # the one that is missing first has ended the process
    assert found.keys() == MISUSES.keys(), (found, done.returncode, done.stderr[-2000:])
    assert [outcome for outcome, one in zip(said, allowed, strict=True) if outcome not in one] == [], found


@needs_sumo
@pytest.mark.parametrize("of_files", [False, True])
@pytest.mark.parametrize("error", [KeyError, KeyboardInterrupt])
def test_an_episode_that_was_interrupted_is_over_and_the_next_one_is_as_ever(
    tmp_path: Path, of_files: bool, error: type[BaseException], monkeypatch: pytest.MonkeyPatch
) -> None:
    """SUMO is closed and begins anew; nobody steps or loads it in the midst of a step."""
    env: DrivingEnv = DrivingEnv("roundabout", {"risk": 1.0})
    if of_files:
        town = files.written(tmp_path / "town", "static")
        env = SumoDrivingEnv(town, ego_vehicle="ego", config={"risk": 1.0})
    expected = np.array([seen for seen, *_ in drive(env, [1] * 8, seed=5)])
    env.reset(seed=1)
    env.step(1)
    step, left = Session.step, [3]

    def interrupted(session: Session) -> Any:
        left[0] -= 1
        if left[0] == 0:
            raise error("in the midst of a step")
        return step(session)

    with monkeypatch.context() as patched, pytest.raises(error):
        patched.setattr(Session, "step", interrupted)
        env.step(1)
    with pytest.raises(SimulatorError, match=r"reset\(\)"):
        env.step(1)
    np.testing.assert_array_equal([seen for seen, *_ in drive(env, [1] * 8, seed=5)], expected)
    env.close()


# What decisions.md lists as the end of libsumo's process, and is neither refused nor among MISUSES.
RARE = """
import sys
from contextlib import closing
from sumo_env.scenarios import SumoDrivingEnv

net, routes = sys.argv[1:]
for seed in range(3):
    options = ["--lanechange.duration", "3"]
    with closing(SumoDrivingEnv(net, routes, ego_vehicle="ego", config={"risk": 1.0}, sumo_options=options)) as env:
        env.reset(seed=seed)
        over = False
        while not over:
            assert not {0, 2} & {*env.get_available_actions()}
            over = any(env.step(2 * (env.steps % 2))[2:4])
        print(seed, flush=True)
"""


@needs_sumo
def test_drivers_that_act_rarely_are_commanded_no_lane_change_that_takes_time(tmp_path: Path) -> None:
    """Neither by a cut-in nor by the agent: SUMO would break down."""
    net = plans.grid(tmp_path, "--grid.number=4", "--grid.length=120", "-L=3", "--no-turnarounds")
    ways = [("A0A1", "D3D2"), ("D0D1", "A3A2"), ("A3B3", "D0C0"), ("C3C2", "B0B1")]
    trip = '<trip id="t{}" type="t" depart="{}" from="{}" to="{}"/>'
    trips = [trip.format(k, k / 2, *ways[k % 4]) for k in range(80)]
    trips.insert(40, trips[40].replace('id="t40"', 'id="ego"'))
    routes = plans.route_file(tmp_path, '<vType id="t" actionStepLength="1.0"/>' + "".join(trips))
    done = ended("-W", "ignore", "-c", RARE, net, routes)
    assert (done.returncode, done.stdout.split()) == (0, ["0", "1", "2"]), done.stderr[-2000:]


def test_an_episode_is_exported_after_sumo_has_died(tmp_path: Path) -> None:
    """Also where the simulator was given, as in a vector environment."""
    with closing(DrivingEnv("u-turn", simulator=SumoProcess())) as env:
        env.reset(seed=0)
        env.step(1)
        process: Any = env._access.simulator
        os.kill(process.pid, signal.SIGKILL)
        with pytest.raises(SimulatorError):
            env.step(1)
        assert tmp_path / "episode.sumocfg" in env.export(tmp_path)
