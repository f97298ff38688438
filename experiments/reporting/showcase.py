"""Films of test episodes: a control agent and a treated agent in the same scenario, for the report's player.

The agents and the scenarios are chosen by a rule that is stated in the report (`RULE`), from the stored tables alone.
Their trajectories come from playing the stored agents again; an episode that does not come out as it was stored is not
shown. What was recorded is kept in DIR/showcase.json, so that the films are still there where the weights are not.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from agents.schema import check
from experiments.analysis.scores import SETTING, in_order
from experiments.study.compute.cell import MakeEnv
from experiments.study.design.arms import ARMS
from experiments.study.design.grid import tested_on
from experiments.study.replaying.rerun import Case, differences, play_again
from experiments.study.results.store import EPISODES, KEY_COLUMNS, Results, Store
from experiments.support.files import canonical_json, read_json, write_file
from experiments.support.films import Film
from sumo_env.rendering.markings import markings
from sumo_env.tasks import get_task

FILE, SCHEMA = "showcase.json", 1
RULE = (
    "The films show the lightest traffic of each task and the first agent of each arm. A fixed rule chooses the "
    "scenarios: at most three in which only the control agent crashes, three in which only the treated agent crashes, "
    "and one in which both crash; risky traffic comes first, then the crash with the highest closing speed."
)
# Scenarios that are shown by (control crashes, treated agent crashes): kind, and how many at most.
KINDS = {(True, False): ("control", 3), (False, True): ("treatment", 3), (True, True): ("both", 1)}
INTERVAL = 0.2  # [s] between two frames of a film
NEAR = 75.0  # [m] from the ego: other vehicles are not stored
MARGIN = 90.0  # [m] around the egos' ways in which the road is stored
FOLLOWED = 120.0  # [m] extent of the egos' ways from which the camera follows them


def showcase(results: Results, left_out: set[str], make_env: MakeEnv) -> dict[str, Any]:
    """All films that the results allow; those that are not recorded yet are, and DIR/showcase.json is written.

    Args:
        left_out: cells that the analysis does not use.

    Returns:
        schema, rule, places (see `_record`) and notes (task by task, why films are missing, in words).

    Raises:
        OSError: the file cannot be written.
    """
    path = results.directory / FILE
    kept = {canonical_json(place["made_of"]): place for place in _stored(path)}
    places, notes = [], []
    for duo in duos(results, left_out):
        cells = duo["cells"]
        tables = {arm: results.episodes[results.episodes["cell"] == name] for arm, name in cells.items()}
        chosen = choose(tables)
        made_of = {
            "cells": {arm: [name, results.cells[name]["files"][EPISODES]] for arm, name in cells.items()},
            "chosen": [[one["traffic"], one["scenario"]] for one in chosen],
        }
        name = f"{duo['task']} {duo['level_name']}"
        if (place := kept.get(canonical_json(made_of))) is None:
            try:
                place = _record(results, duo, tables, chosen, make_env)
            except Exception as error:  # whatever is wrong with a film must not cost the report
                notes.append(f"{name}: the agents could not be replayed ({str(error).partition(chr(10))[0]})")
                continue
            place["made_of"] = made_of
        notes += [f"{name}: {reason}" for reason in place["failed"]]
        places.append(place)
    if places or path.exists():
        data = {"schema": SCHEMA, "rule": RULE, "places": places}
        text = json.dumps(data, separators=(",", ":"), allow_nan=False) + "\n"
        write_file(path, text.encode())
    return {"rule": RULE, "places": places, "notes": notes}


def _stored(path: Path) -> list[dict[str, Any]]:
    """The recorded places; none if the file is missing, damaged or of another version."""
    try:
        value = read_json(path)
        check(value, {"schema": (SCHEMA,), "places": [{"made_of": dict, "films": list, "failed": [str]}]})
        return list(value["places"])
    except (OSError, ValueError):
        return []


def duos(results: Results, left_out: set[str]) -> Iterator[dict[str, Any]]:
    """The agents that are shown: of each simulator and task at the lowest level, of the lowest seed in both arms.

    By SETTING and seed, with the names of their cells by arm.
    """
    agents = results.episodes[list(KEY_COLUMNS)].drop_duplicates()
    mine = (agents["kind"] == "agent") & agents["arm"].isin(list(ARMS)) & ~agents["cell"].isin(list(left_out))
    setting = [*SETTING, "seed"]
    whole = agents[mine].groupby(setting).filter(lambda pair: set(pair["arm"]) == set(ARMS))
    lowest = in_order(whole, "backend", "task", "level", "seed", "arm").groupby(["backend", "task"])
    for _, pair in lowest.head(len(ARMS)).groupby(setting, sort=False):
        cells = dict(zip(pair["arm"], pair["cell"], strict=True))
        yield {**pair[setting].to_dict("records")[0], "cells": cells}


def choose(tables: Mapping[str, pd.DataFrame]) -> list[dict[str, Any]]:
    """The common test scenarios that are shown: kind, traffic, scenario.

    Args:
        tables: the test episodes of the two agents by arm.
    """
    keys = ["traffic", "scenario"]
    columns = [*keys, "crashed", "crash_closing_speed"]
    both = tables["control"][columns].merge(tables["treatment"][columns], on=keys, suffixes=("_c", "_t"))
    speed = both[["crash_closing_speed_c", "crash_closing_speed_t"]].astype(float).max(axis=1).fillna(0.0)
    both = both.assign(speed=speed)
    both = both.sort_values(["traffic", "speed"], ascending=False, kind="stable")  # risky first
    chosen = []
    for (control, treated), (kind, most) in KINDS.items():
        rows = both[(both["crashed_c"].astype(bool) == control) & (both["crashed_t"].astype(bool) == treated)]
        chosen += [{"kind": kind, **one} for one in rows[keys].head(most).to_dict("records")]
    return chosen


def _record(
    results: Results,
    duo: Mapping[str, Any],
    tables: Mapping[str, pd.DataFrame],
    chosen: Sequence[Mapping[str, Any]],
    make_env: MakeEnv,
) -> dict[str, Any]:
    """Play the chosen scenarios again.

    Returns:
        backend, task, level, level_name, seed, cells, road (see `_road`), follow (whether the camera follows the egos,
        else it shows `view`, [x, y, width, height] in m), films (kind, traffic, scenario, and for each arm a track, see
        `_film`), failed (what could not be shown, in words).
    """
    films, failed, ways = [], [], []
    key = results.cells[duo["cells"]["control"]]["key"]
    with closing(make_env(*tested_on(key))) as env:
        for one in chosen:
            traffic, scenario = one["traffic"], one["scenario"]
            film = dict(one)
            for arm, name in duo["cells"].items():
                scenes = Scenes(env)
                at = (tables[arm]["traffic"] == traffic) & (tables[arm]["scenario"] == scenario)
                stored = tables[arm][at].iloc[0].drop(list(KEY_COLUMNS)).to_dict()
                case = Case(Store(results.directory), name, results.cells[name], stored)
                row = play_again(case, env, scenes.frame)
                if wrong := differences(stored, row):
                    failed.append(
                        f"{traffic} scenario {scenario} is not shown, because the {arm} agent drives it "
                        f"differently on this machine ({wrong[0]})"
                    )
                    break
                film[arm] = _film(scenes.pictures, row)
                ways.append(np.array([(scene.x[0], scene.y[0]) for scene in scenes.pictures]))
            else:
                films.append(film)
    way = np.concatenate(ways) if ways else np.zeros((1, 2))
    low, high = way.min(axis=0), way.max(axis=0)
    extent = high - low
    view = [round(float(value), 1) for value in (*((low + high) / 2), *extent)]
    road = _road(key["task"], key["env_config"], low - MARGIN, high + MARGIN)
    camera = {"follow": bool(extent.max() > FOLLOWED), "flat": bool(extent[1] < 20.0), "view": view}
    return {**duo, **camera, "road": road, "films": films, "failed": failed}


class Scenes(Film):
    """The scenes of an episode in the place of pictures: after every sub-step, where the simulator offers them."""

    frequency = math.inf

    def picture(self) -> Any:
        """The present scene."""
        return self.env.scene


def _film(scenes: Sequence[Any], row: Mapping[str, Any]) -> dict[str, Any]:
    """An episode as small numbers.

    Returns:
        times [0.01 s]; cars: the ego first, for each the number of its first frame and, for each frame, x, y
        [0.1 m] and heading [0.01 rad]: the first value, then differences; acts: the frames in which a risk event acts
        on the car, absent without one; speeds of the ego [0.1 m/s]; crash [s] and
        hit (number of the car that was hit), None without a crash; ending and row: what is said of it.
    """
    frames: list[Any] = []
    for scene in scenes:
        if not frames or scene.time - frames[-1].time > INTERVAL - 1e-6:
            frames.append(scene)
    if frames[-1] is not scenes[-1]:
        frames.append(scenes[-1])
    rows = pd.concat(
        pd.DataFrame({"frame": k, "name": scene.ids, "x": scene.x, "y": scene.y, "h": scene.heading})[
            np.hypot(scene.x - scene.x[0], scene.y - scene.y[0]) <= NEAR
        ]
        for k, scene in enumerate(frames)
    )
    back = rows.groupby("name")["frame"].diff() != 1  # new, or back again: a car of its own
    cars: list[dict[str, Any]] = []
    hit = None
    for (name, _), track in rows.groupby(["name", back.groupby(rows["name"]).cumsum()], sort=False):
        if row["crashed"] and name == row["crash_other"]:
            hit = len(cars)
        acts = [k for k in track["frame"].tolist() if name in frames[k].in_event]
        whole = np.rint(track[["x", "y"]].assign(h=np.unwrap(track["h"])) * [10, 10, 100]).astype(int)
        steps = whole.diff().fillna(whole).astype(int).to_dict("list")
        cars.append({"from": int(track["frame"].iloc[0]), **({"acts": acts} if acts else {}), **steps})
    return {
        "times": [round(100 * scene.time) for scene in frames],
        "cars": cars,
        "speeds": [round(10 * float(scene.speed[0])) for scene in frames],
        "crash": round(float(row["crash_time"]), 2) if row["crashed"] else None,
        "hit": hit,
        "ending": ending(row),
        "return": round(float(row["return"]), 2),
    }


def ending(row: Mapping[str, Any]) -> str:
    """How an episode ended, in words."""
    if row["crashed"]:
        speed = row["crash_closing_speed"]
        return f"{row['crash_type']} crash after {row['crash_time']:.1f} s, closing at {speed:.0f} m/s"
    return "reaches its goal" if row["arrived"] else "no crash until the time is up"


def _road(task: str, config: Mapping[str, Any], low: Any, high: Any) -> dict[str, Any]:
    """The road around a window [m]: surfaces (polygons) and dashes (x, y, x, y), in 0.1 m."""
    paint = markings(get_task(task).road(dict(config)))

    def near(points: Any) -> bool:
        return bool((points.min(axis=0) <= high).all() and (points.max(axis=0) >= low).all())

    dashes = [np.array([(p[0] + p[-1]) / 2, (p[len(p) // 2 - 1] + p[len(p) // 2]) / 2]) for p in paint.dashes]
    return {
        "surfaces": [_dm(polygon) for polygon in paint.surfaces if near(polygon)],
        "dashes": [_dm(dash) for dash in dashes if near(dash)],
    }


def _dm(points: Any) -> list[int]:
    return [int(value) for value in np.rint(np.asarray(points) * 10).ravel()]
