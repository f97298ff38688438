"""Numbers and figures of the documentation are computed a second time, from the stored results."""

import json
import re
from collections import Counter
from itertools import product
from statistics import fmean
from typing import Any
from unittest.mock import patch

import pyarrow.parquet as pq
import pytest
from matplotlib.axes import Axes
from pytest import approx

from docs import pages, settings
from experiments.analysis.plan import DENSEST
from experiments.reporting.figures import alone
from experiments.reporting.rare import MEASURED
from experiments.reporting.tables import chosen
from experiments.study.design import attainable
from experiments.study.design.sheet import GRID, VARIANTS
from experiments.study.design.traffic import TRAFFICS
from tests.processes import ROOT
from tests.test_docs import TEXTS, page, section, table


def test_doses_in_units_of_the_road_are_those_of_the_table() -> None:
    stored = pq.read_table(ROOT / "results" / "road-units.parquet").to_pylist()
    highway = [line for line in stored if line["task"] == "highway"]
    assert [line["traffic"] for line in highway] == ["0", "0.25", "0.5", "0.75", "1", "measured"]
    with patch.object(Axes, "plot") as calls:
        pages.FIGURES["road-units"]()
    drawn = [[*map(list, call.args)] for call in calls.call_args_list]
    for unit in ("braking_4.4", "cut_ins", "headway"):
        *doses, measured = (line[unit] for line in highway)
        assert [[0.0, 0.25, 0.5, 0.75, 1.0], doses] in drawn
        assert (
            unit == "cut_ins" or [[MEASURED], [measured]] in drawn
        )  # these drivers never force their way in
    kinds = sum(any(line["cut_ins"] for line in stored if line["task"] == task) for task in GRID)
    assert len(drawn) == 2 * 2 * len(GRID) + kinds + 1  # and the rate of roads


def test_settings_that_learn_are_those_of_readme_s_script() -> None:
    """And their rows are complete; the table of the page is held by its template."""
    script = section(TEXTS[ROOT / "README.md"], "Train")
    given = re.search(r"DQN\(\s+\"MlpPolicy\",\s+env,(.*?)^\)", script, re.DOTALL | re.MULTILINE)
    assert given
    (asked, steps), written = settings.SETTINGS["two-way-brakes/1"], eval(f"dict({given[1]})")
    for left in (1.0, 0.5, 0.0):
        assert written["learning_rate"](left) == asked["learning_rate"](left)
    assert written == {**asked, "seed": 0, "learning_rate": written["learning_rate"]}
    assert f"learn({steps:_}, progress_bar=True)" in script
    assert f'"target_speeds": {VARIANTS["two-way-brakes"].changes["action"]["target_speeds"]}' in script
    rows = json.loads(settings.ROWS.read_text(encoding="utf-8"))
    expected = set()
    for task, steps in settings.TASKS.items():
        env: Any = settings.made(task).unwrapped
        assert env.config["duration"] * env.config["policy_frequency"] == steps
        for risk in settings.RISKS:
            expected |= {f"{task}/{risk}/{driver}" for driver in settings.drivers(env, task, risk)}
        env.close()
    assert rows.keys() == expected
    agents = [row["crashes"] for name, row in rows.items() if re.fullmatch(r"two-way-brakes/1/\d", name)]
    found, constant = (
        settings.readme_agents(),
        rows[f"two-way-brakes/1/{settings.readme_agents()['constant']}"],
    )
    assert (found["count"], found["least"], found["most"]) == (10, min(agents), max(agents))
    assert found["worst"] > found["of_constant"] == constant["return"]
    for (task, most), risk in product(settings.TASKS.items(), settings.RISKS):
        first, random = rows[f"{task}/{risk}/0"], rows[f"{task}/{risk}/random"]
        # at first an agent explores, in the end it drives as in the test
        assert len(first["curve"]) == settings.POINTS
        assert first["curve"][0] == approx(random["return"], abs=0.1 * most)
        assert first["curve"][-1] == approx(first["return"], abs=0.15 * most)


def test_scenarios_of_the_two_way_road_that_nothing_survives_are_those_that_were_found() -> None:
    rows = table(page("environments/two-way.md"))
    for task, shown in (("two-way", rows["[20, 25, 30]`, highway-env's (`two-way` in the study)"]),
                        ("two-way-brakes", rows["[10, 20, 30]` (`two-way-brakes`)"])):  # fmt: skip
        for level, text in zip(GRID["two-way"], shown, strict=True):
            shares = [
                attainable.stored()[f"{task} {level} {traffic}"]["search"]["no_safe"] for traffic in TRAFFICS
            ]
            assert text == "{:.0f}, {:.0f} %".format(*(100 * share for share in shares))


def test_the_checks_of_the_validation_are_counted() -> None:
    verdict = json.loads((ROOT / "experiments" / "validation" / "verdict.json").read_text())
    studied = [verdict[task] for task in GRID]
    found = pages.validation()
    assert found["all"] == sum(sum(own["counts"].values()) for own in studied)
    outside = [item["verdict"] for own in studied for item in own["outside"]]
    assert found["outside"] == len(outside) == found["all"] - found["equivalent"] - found["within"]
    assert found["missed"] == outside.count("missed")
    one_by_one = pages.checks()
    assert len(one_by_one) == found["all"]
    assert (one_by_one["metric"] == "order").sum() == found["orders"]


def episodes_of(setting: str, arm: str, traffic: str) -> list[dict[str, Any]]:
    """The stored test episodes of an arm's agents at home."""
    files = (ROOT / "results" / "study-6" / "parts").glob(f"sumo-{setting}-*.parquet")
    rows = [row for file in files for row in pq.read_table(file).to_pylist()]
    mine = [row for row in rows if (row["purpose"], row["traffic"]) == ("test", traffic)]
    return [row for row in mine if re.match(rf"sumo-{setting}-{arm}-s\d+-\w+$", row["cell"])]


def test_numbers_of_the_study_are_those_of_its_stored_episodes() -> None:
    """Of a task the mean over its settings."""
    place = {"scope": "u-turn", "traffic": "regular", "tested_on": "sumo"}
    close, near_misses = list[float](), list[float]()
    for level in GRID["u-turn"]:
        treated = episodes_of(f"u-turn-{level}", "treatment", "regular")
        assert len(treated) == 5 * 400
        close.append(sum(row["min_ttc"] < 1 for row in treated) / 2000)
        sums: dict[str, Counter[str]] = {name: Counter() for name in ("near_misses", "distance")}
        for row in treated:
            for name, of_agents in sums.items():
                of_agents[row["cell"]] += row[name]
        near_misses.append(
            fmean(1e3 * sums["near_misses"][cell] / sums["distance"][cell] for cell in sums["distance"])
        )
    assert pages.row("by_task", outcome="close", **place)["mean_arm"] == approx(fmean(close))
    found = pages.row("by_task", outcome="near_misses_per_km", **place)
    assert found["mean_arm"] == approx(fmean(near_misses))

    arms = [pages.failing(arm) for arm in ("control", "treatment")]
    assert sum(arm["passed"] for arm in arms) == pages.failing()["passed"] and arms[0]["of"] == 90
    assert pages.events_per_hour("u-turn") == approx(3600 / 5 + 3600 / 10)  # docs/traffic-and-risk.md


@pytest.mark.parametrize(("task", "traffic"), [("u-turn", "risky"), ("intersection", "regular")])
def test_skill_and_caution_are_counted_from_the_stored_moments(task: str, traffic: str) -> None:
    [file] = (ROOT / "results" / "study-6" / "takeover" / task).glob("*.parquet")
    stored = [row for row in pq.read_table(file).to_pylist() if row["traffic"] == traffic]
    for within in (2, 3):
        danger, escapes = list[float](), list[dict[str, float]]()
        for leader in ("a", "b"):
            led = [row for row in stored if (row["leader"], row["within"]) == (leader, within)]
            moments = [row for row in led if row["moment"] is not None]
            danger.append((len(moments) + sum(row["sudden"] for row in led)) / len(led))
            names = ("a", "b", "sumo")
            escapes.append({name: fmean(row[f"crash_{name}"] <= 5 for row in moments) for name in names})
        assert pages.answer(task, traffic, "caution", within)["estimate"] == approx(danger[1] - danger[0])
        mean = {name: fmean(share[name] for share in escapes) for name in names}
        assert pages.answer(task, traffic, "skill", within)["estimate"] == approx(mean["b"] - mean["a"])
    assert {name: pages.from_moments(task, traffic)[name] / 100 for name in names} == approx(mean)


def test_readme_s_sentences_are_what_the_study_decided() -> None:
    """In their order: fewer crashes in risky traffic, more and fewer in regular traffic, caution, skill."""
    verdicts, answers = pages.study().primary, pages.skill_or_caution()
    of = {name: set(own["scope"]) for name, own in verdicts.groupby(["term", "verdict"])}
    assert of["risky", "less"] == {*GRID}
    assert of["regular", "more"] == {"two-way", "intersection"}
    assert of["regular", "less"] == {"roundabout", "u-turn"}
    became = [line.split("|") for line in pages.beside_plan_5().splitlines()]
    dense = [f" {task} {level} " for task, level in DENSEST]
    decided = [line[1:3] for line in became if line[1] in dense and line[-2] in (" stands ", " new ")]
    assert decided == [
        [" highway 150 ", " regular "],
        [" intersection 30 ", " regular "],
        [" u-turn 12 ", " risky "],
    ]
    assert ("risky", "more") not in of
    who = answers.set_index(["task", "traffic"]).filter(like="who is more")
    careful, skilled = ([*who.index[who[name] == "treated agents"]] for name in who)
    assert set(careful) == {*product(("roundabout", "u-turn"), TRAFFICS)}
    assert set(skilled) == {(task, "risky") for task in answers["task"]}
    assert [*who.index[who["who is more skilled"] == "control agents"]] == [("two-way-brakes", "regular")]


def test_what_the_study_says_of_levels_is_what_their_intervals_say() -> None:
    def sides(task: str, traffic: str, outcome: str = "crashed") -> dict[str, int]:
        place = {"term": traffic, "outcome": outcome, "arm": "treatment", "against": "control"}
        levels = chosen(pages.study().effects, backend="sumo", task=task, **place).to_dict("records")
        return {one["level_name"]: int(one["low"] > 0) - int(one["high"] < 0) for one in levels}

    assert sides("highway", "regular") == {"50": 0, "100": -1, "150": 1}
    assert sides("intersection", "regular") == {"10": 0, "15": 0, "20": 1, "25": 1, "30": 1}
    assert sides("two-way", "regular") == {"5+2": 1, "10+4": 1}
    densest = {task: [*sides(task, "risky").values()][-1] for task in GRID}
    assert densest == {**dict.fromkeys(GRID, 0), "u-turn": -1}
    assert sides("highway", "risky", "mean_speed") == {"50": 0, "100": -1, "150": 0}
    assert sides("roundabout", "risky", "mean_speed") == {"5": -1, "10": -1, "15": 0}
    assert set(sides("u-turn", "risky", "mean_speed").values()) == {-1}
    replica = pages.row("by_task", scope="two-way", traffic="risky", tested_on="replica", outcome="crashed")
    assert replica["low"] < 0 < replica["high"]


def test_what_became_of_an_effect_follows_from_both_intervals() -> None:
    lines = pages.beside_plan_5().splitlines()[2:]
    became = Counter(line.split("|")[-2].strip() for line in lines)
    assert became == {"stands": 9, "not decided": 5, "new": 1}  # as the sentence below the table says
    for line in lines:
        ends = [float(end.replace("−", "-")) for end in re.findall(r"[-+−]?\d+\.\d(?=[,\]])", line)]
        before, now = ((low > 0) - (high < 0) for low, high in (ends[:2], ends[2:]))
        words = {"stands": before == now != 0, "turns": before == -now != 0, "new": not before and now}
        words |= {"not decided": before and not now}
        assert words[line.split("|")[-2].strip()], line


@pytest.mark.parametrize("name", pages.FIGURES)
def test_a_figure_is_what_the_stored_episodes_make(name: str) -> None:
    """Up to the last digits, which hang on the processor."""
    number = re.compile(r"-?\d+\.\d+")
    then = pages.figure_file(name).read_text(encoding="utf-8")
    now = alone(pages.FIGURES[name]())
    assert number.sub("#", then) == number.sub("#", now)
    assert list(map(float, number.findall(then))) == approx(list(map(float, number.findall(now))), abs=0.01)
