"""Reading changes nothing: an episode is that of plain ``sumo``, however often it is read and whatever is asked."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from gymnasium.wrappers import RecordVideo

from sumo_env.scenarios import SumoDrivingEnv
from sumo_env.traffic.sumo_schemas import schema
from tests.sumo_env.plans import SUMO_DRIVES, grid, needs_sumo
from tests.sumo_env.rollout import drive
from tests.sumo_env.scenarios.test_oracle import differences, driven, plain

SECONDS = 60
# Of SUMO's junction models, each with a value that matters; probabilities are those of drawing.
JUNCTIONS = {
    "jmAdvance": "0.5",
    "jmAllwayStopWait": "0.5",
    "jmCrossingGap": "5",
    "jmDriveAfterRedTime": "2",
    "jmDriveAfterYellowTime": "1",
    "jmDriveRedSpeed": "5",
    "jmExtraGap": "1",
    "jmIgnoreFoeProb": "0.5",
    "jmIgnoreFoeSpeed": "20",
    "jmIgnoreJunctionFoeProb": "0.5",
    "jmIgnoreKeepClearTime": "5",
    "jmSigmaMinor": "0.5",
    "jmStopSignWait": "1",
    "jmStoplineCrossingGap": "2",
    "jmStoplineGap": "2",
    "jmStoplineGapMinor": "2",
    "jmTimegapMinor": "1.5",
    "impatience": "0.5",
}


def written(folder: Path, kind: str) -> Path:
    """Much traffic on a grid, whose junctions are of one kind, of drivers with all these attributes."""
    grid(folder, "--grid.number=3", "--grid.length=120", "-L=2", f"--default-junction-type={kind}")
    types = " ".join(f'{name}="{value}"' for name, value in JUNCTIONS.items())
    flows = "".join(
        f'<flow id="f{k}" type="t" begin="0" end="60" probability="0.25" from="{start}" to="{end}"/>'
        for k, (start, end) in enumerate(
            (("A0A1", "C2C1"), ("C0B0", "A2A1"), ("A2B2", "C1C0"), ("C2C1", "A0B0"))
        )
    )
    ego = '<trip id="ego" type="t" depart="10" from="A1B1" to="C1C2"/>'
    (folder / "t.rou.xml").write_text(f'<routes><vType id="t" {types}/>{flows}{ego}</routes>')
    config = folder / "t.sumocfg"
    config.write_text(
        '<configuration><input><net-file value="grid.net.xml"/><route-files value="t.rou.xml"/></input></configuration>'
    )
    return config


def test_all_attributes_of_junction_models_are_looked_at() -> None:
    known = {name for names in schema("route").values() for name in names if name.startswith("jm")}
    assert known - {"jmIgnoreIDs", "jmIgnoreTypes"} <= JUNCTIONS.keys()


@needs_sumo
@pytest.mark.parametrize("kind", ["priority", "traffic_light", "right_before_left"])
def test_whatever_is_read_an_episode_is_sumo_s(tmp_path: Path, kind: str) -> None:
    """Read with and without sub-steps, ten times as often, filmed, and with all features that ask SUMO."""
    net, found = written(tmp_path, kind), []
    features: dict[str, Any] = {"type": "Kinematics", "features": ["x", "y", "foe_gap", "foe_speed"]}
    for read in ({}, {"observation": features}, {"policy_frequency": 10, "observation": features}):
        config = {"duration": SECONDS, "action": SUMO_DRIVES, **read}
        with closing(SumoDrivingEnv(net, ego_vehicle="ego", config=config)) as env:
            env.reset(seed=3)
            scenes = driven(env, SECONDS * env.config["policy_frequency"])
            assert differences(scenes, plain(env.sumo_command, tmp_path, scenes), 0.1) == []
    for filmed in (False, True):
        config = {"duration": SECONDS, "action": SUMO_DRIVES, "observation": features}
        with closing(SumoDrivingEnv(net, ego_vehicle="ego", config=config, render_mode="rgb_array")) as env:
            film = RecordVideo(env, str(tmp_path / "film")) if filmed else env
            film.reset(seed=3)
            begin = float(env.sumo.simulation.getTime())
            results = list(drive(film, 0))
            scene = begin + env.scene.time, env.scene
            found.append([reward for _, reward, *_ in results])
            assert (
                env.scene.place.ended
                or differences([scene], plain(env.sumo_command, tmp_path, [scene]), 0.1) == []
            )
    assert found[0] == found[1]
