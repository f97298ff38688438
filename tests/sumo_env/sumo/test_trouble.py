"""libsumo used behind the environment's back: an error that says so, or an episode that goes on; never a dead process.

The misuses run in a process of their own, because the wrong outcome is the end of that process.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sumo_env.env import DrivingEnv
from sumo_env.scenarios import SumoDrivingEnv
from sumo_env.simulator import SimulatorError
from sumo_env.sumo.session import Session
from tests.processes import ended
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
        env = SumoDrivingEnv(
            files.written(tmp_path / "town", "static"), ego_vehicle="ego", config={"risk": 1.0}
        )
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
