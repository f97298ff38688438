"""What is driven, where it is stored, and that it is driven once."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from agents import pretrained
from experiments.backends import make_env
from experiments.study.compute.evaluate import Drive, play
from experiments.validation import episodes
from experiments.validation.episodes import COLUMNS, CORE, HEADWAYS, Engine, Part, egos, plan, run
from sumo_env.networks.roads import highway
from sumo_env.scene import Scene

SUMO = Engine("sumo", "sumo")


def test_every_scenario_is_driven_by_every_ego() -> None:
    part = Part(Path(), SUMO, "u-turn", 1, "regular", range(3))
    assert part.each() == [(scenario, ego) for scenario in range(3) for ego in egos("u-turn")]
    assert "faster" not in egos("intersection")  # which is idle there
    assert set(CORE) - {"faster"} <= set(egos("two-way"))


def test_published_agents_drive_where_there_are_some() -> None:
    """With the configuration that they were trained in, whatever the validation's is."""
    agents = Engine("sumo", "sumo", egos=episodes.AGENTS)
    planned = plan([agents], {"u-turn": [1, 2], "merge": [1]}, ["regular"], range(2))
    assert [(part.task, part.level) for part in planned] == [("u-turn", 1)]
    table = planned[0].rows()
    assert table["ego"].tolist() == [*episodes.AGENTS] * 2
    env = make_env("sumo", "u-turn", pretrained.card("u-turn-3", "control")["config"])
    row = play(env, pretrained.load("u-turn-3", "control"), Drive("u-turn", 1, "regular", 1))
    assert table["return"].iloc[2] == pytest.approx(row["return"])


def test_a_random_part_is_the_same_however_it_is_divided() -> None:
    few = Engine("few", "sumo", one_in=20)
    whole = Part(Path(), few, "u-turn", 1, "regular", range(200)).each()
    halves = [
        Part(Path(), few, "u-turn", 1, "regular", part).each() for part in (range(100), range(100, 200))
    ]
    assert whole == halves[0] + halves[1]
    assert 0.02 < len(whole) / (200 * len(egos("u-turn"))) < 0.08


def test_plan_leaves_out_what_cannot_differ(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(episodes, "SIZE", 10)
    engines = [Engine(name, "replica", {"variant": name}) for name in ("path", "v0")]
    planned = plan(engines, {"highway": [1], "u-turn": [1, 2]}, ["regular", "risky"], range(25))
    driven = {(p.engine.name, p.task) for p in planned}
    assert driven == {("path", "highway"), ("path", "u-turn"), ("v0", "u-turn")}
    assert sorted({p.scenarios for p in planned}, key=min) == [range(10), range(10, 20), range(20, 25)]
    assert len({p.name for p in planned}) == len(planned)


def test_other_dynamics_or_settings_are_other_files(monkeypatch: pytest.MonkeyPatch) -> None:
    others = [
        Engine("sumo", "sumo", options={"calibration": {"assertive": 1.0}}),
        Engine("sumo", "sumo", options={"risk_rates": {"brake": 1.0}}),
        Engine("sumo", "sumo", egos=("idle",)),
        Engine("sumo", "sumo", {"simulation_frequency": 15}),
        Engine("sumo", "sumo", one_in=2),
        Engine("sumo", "replica"),
    ]
    files = {Part(Path(), engine, "u-turn", 1, "regular", range(3)).name for engine in [SUMO, *others]}
    assert len(files) == 1 + len(others)
    monkeypatch.setattr(episodes, "dynamics", lambda *_: "other")
    assert Part(Path(), SUMO, "u-turn", 1, "regular", range(3)).name not in files


def test_the_traffic_is_that_of_the_others_near_the_ego() -> None:
    """Of two cars that are followed for half a second one changes lane: a change in a 60th of a vehicle-minute.

    A wreck is in the way, but does not drive.
    """
    x, speed = np.array([0.0, 20.0, 50.0, 300.0, 90.0]), np.array([40.0, 10.0, 20.0, 5.0, 0.0])
    ids, moved = ("ego", "a", "b", "far", "wreck"), [np.array([0.0, y, 4.0, 0.0, 0.0]) for y in (0.0, 4.0)]
    scenes = [Scene(ids, x, y, speed, 0 * x, x == 90.0, 0.5 * k) for k, y in enumerate(moved)]
    found = episodes.traffic_near(scenes, "highway", highway(), 0.5)
    assert (found["traffic_speed"], found["density"]) == (15.0, 3.0)
    assert found["lane_changes"] == pytest.approx(60.0)


def test_episodes_are_measured() -> None:
    table = Part(
        Path(), Engine("sumo", "sumo", egos=("idle", "careful")), "u-turn", 2, "risky", range(3)
    ).rows()
    assert list(table.columns) == list(COLUMNS)
    assert len(table) == 6
    assert ((table["outcome"] == "crashed") == table["crashed"]).all()
    assert (table["crash_time"].notna() == table["crashed"]).all()
    assert table["traffic_speed"].between(1, 25).all()
    assert (table[HEADWAYS].to_numpy().sum(axis=1) > 0).any()


def test_settings_of_drivers_and_risk_reach_the_simulator() -> None:
    def table(**changes):
        engine = Engine("sumo", "sumo", egos=("idle",), **changes)
        return Part(Path(), engine, "u-turn", 1, "risky", range(4)).rows()

    present = table()
    quiet = table(options={"risk_rates": {"cut_in": 0.0, "brake": 0.0, "surge": 0.0}})
    assert not present.equals(quiet)
    same = table(options={"risk_rates": {"cut_in": episodes.TASKS["u-turn"].risk_rates.cut_in}})
    assert present.equals(same)  # the same rates draw the same scenarios
    drivers = {"lane_changes": True, "assertive": 5.0, "speed_gain": 200.0}
    assert not present.equals(table(options={"calibration": drivers}))


@pytest.mark.slow
def test_what_is_there_is_not_driven_again(
    tmp_path: Path, here: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(episodes, "SIZE", 2)
    planned = plan([Engine("sumo", "sumo", egos=("idle",))], {"u-turn": [1]}, ["regular"], range(4))
    run(planned[:1], tmp_path, 1)
    file = replace(planned[0], directory=tmp_path).path
    written = file.stat().st_mtime_ns
    assert run(planned, tmp_path, 2)["scenario"].tolist() == [0, 1, 2, 3]
    assert file.stat().st_mtime_ns == written
