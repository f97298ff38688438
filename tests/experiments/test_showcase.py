"""The films of the report: which are chosen, that they show what was stored, and that the page plays them."""

from __future__ import annotations

import json
import re
import shutil
import subprocess

import numpy as np
import pandas as pd
import pytest

from experiments import report
from experiments.reporting.showcase import FILE, Scenes, choose, duos, showcase
from experiments.study.replaying.rerun import Case, play_again
from experiments.study.results.store import Store, load
from tests.experiments.computed import compute, tasks_of
from tests.experiments.fake_env import make_env, make_other_env


@pytest.fixture(scope="module")
def directory(tmp_path_factory):
    """The agents of a tiny sweep in the fake environment."""
    home = tmp_path_factory.mktemp("results")
    tasks = tasks_of(home, preset="quick", tasks=("highway",), seeds=1, updates=100, episodes=6, network=None)
    compute(task for task in tasks if task.cell.kind == "agent" or task.cell.policy == "slower")
    return home


@pytest.fixture
def copy(directory, tmp_path):
    shutil.copytree(directory, tmp_path / "results")
    return tmp_path / "results"


def table(*rows) -> pd.DataFrame:
    return pd.DataFrame(rows, columns=["traffic", "scenario", "crashed", "crash_closing_speed"])


def test_the_choice_is_balanced_and_takes_the_hardest_crashes_in_risky_traffic_first():
    control = table(
        *(("regular", n, True, 30.0) for n in range(4)),
        *(("risky", n, True, float(n)) for n in range(2)),
        ("risky", 2, False, None),
        ("risky", 3, True, 9.0),
        ("risky", 4, False, None),
    )
    treated = control.assign(crashed=[False] * 6 + [True, True, False], crash_closing_speed=5.0)
    chosen = choose({"control": control, "treatment": treated})
    assert [tuple(one.values()) for one in chosen] == [
        ("control", "risky", 0),
        ("control", "risky", 1),
        ("control", "regular", 0),
        ("treatment", "risky", 2),
        ("both", "risky", 3),
    ]


def test_the_agents_are_those_of_the_lowest_level_and_seed(directory):
    results = load(directory)
    [duo] = duos(results, set())
    cells = duo.pop("cells")
    assert duo == {"backend": "sumo", "task": "highway", "level": 1, "level_name": "50", "seed": 0}
    assert set(cells) == {"control", "treatment"}
    assert list(duos(results, {cells["control"]})) == []


def test_a_film_is_the_stored_episode(copy):
    results = load(copy)
    found = showcase(results, set(), make_env)
    assert found["notes"] == []
    [place] = found["places"]
    assert place["films"]
    for film in place["films"]:
        for arm, name in place["cells"].items():
            record, place_of = results.cells[name], {key: film[key] for key in ("traffic", "scenario")}
            env = make_env("sumo", "highway", record["key"]["env_config"])
            recorded = Scenes(env)
            row = play_again(Case(Store(copy), name, record, place_of), env, recorded.frame)
            scenes = recorded.pictures
            track = film[arm]
            assert track["times"] == [round(100 * scene.time) for scene in scenes]
            assert (track["crash"] is not None) == row["crashed"]
            leader = track["cars"][1]
            x = np.cumsum(leader["x"]) / 10
            first = leader["from"]
            assert x == pytest.approx([scene.x[1] for scene in scenes[first : first + len(x)]], abs=0.051)
            if row["crashed"]:
                assert track["hit"] == 1


def test_films_outlive_the_weights(copy):
    results = load(copy)
    before = showcase(results, set(), make_env)
    for path in copy.glob("cells/*/weights.npz"):
        path.unlink()
    assert showcase(results, set(), make_env) == before
    (copy / FILE).unlink()
    assert showcase(results, set(), make_env) == before  # from the stored actions
    results.episodes["actions"] = float("nan")  # as in cells of earlier versions
    (copy / FILE).unlink()
    after = showcase(results, set(), make_env)
    assert after["places"] == []
    [note] = after["notes"]
    assert note.startswith(
        "highway 50: the agents could not be replayed (the weights of sumo-highway-50-control-s0"
    )


@pytest.mark.parametrize("content", ["", '{"schema": 0}'])
def test_a_damaged_record_is_made_again(copy, content):
    results = load(copy)
    before = showcase(results, set(), make_env)
    (copy / FILE).write_text(content)
    assert showcase(results, set(), make_env) == before
    assert json.loads((copy / FILE).read_text())["places"]


def test_an_episode_that_comes_out_differently_is_not_shown(copy):
    found = showcase(load(copy), set(), make_other_env)
    assert found["places"][0]["films"] == []
    assert "differently on this machine" in found["notes"][0]


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("chromium") is None, reason="needs a browser")
def test_the_page_plays_without_an_error(copy, monkeypatch):
    monkeypatch.setattr(report, "make_env", make_env)
    page = report.write_report(copy)
    press = """<script>
      window.onerror = (message) => { document.title = `error: ${message}`; };
      const key = (name) => document.getElementById("player").dispatchEvent(new KeyboardEvent("keydown", {key: name}));
      const player = document.getElementById("player"), start = player.dataset.time;
      const slider = player.querySelector("[data-part=time]");
      const moved = () => { slider.dispatchEvent(new Event("input")); return player.dataset.time; };
      const set = (value) => { slider.value = value; return moved(); };
      const end = set(slider.max), home = set("0");
      key("ArrowRight"); const step = player.dataset.time; key(" "); const playing = player.dataset.playing;
      const tell = () => { document.title = JSON.stringify([start, end, home, step, playing, player.dataset.time]); };
      setTimeout(tell, 700);
    </script></body>"""
    page.write_text(page.read_text().replace("</body>", press))
    options = ["--headless", "--no-sandbox", "--disable-gpu", "--virtual-time-budget=2000", "--dump-dom"]
    done = subprocess.run(["chromium", *options, str(page)], capture_output=True, text=True, timeout=300)
    title = re.search("<title>(.*?)</title>", done.stdout)[1]
    start, end, home, step, playing, later = json.loads(title)
    assert (home, step, playing) == ("0.0", "0.2", "true")
    film = json.loads((copy / "showcase.json").read_text())["places"][0]["films"][0]
    crash = min(film[arm]["crash"] for arm in ("control", "treatment") if film[arm]["crash"] is not None)
    assert float(start) == pytest.approx(max(crash - 2.0, 0.0), abs=0.05)  # before the crash
    assert float(end) >= crash
    assert float(later) > float(step)
