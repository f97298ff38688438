"""What protects readers of the documentation: links, snippets and commands work, and what there is is named."""

from __future__ import annotations

import importlib.util
import json
import re
from ast import literal_eval
from collections import Counter
from collections.abc import Iterable
from itertools import dropwhile, product, takewhile
from pathlib import Path
from statistics import fmean
from typing import Any
from unittest.mock import patch

import gymnasium as gym
import pyarrow.parquet as pq
import pytest
from matplotlib.axes import Axes
from pytest import approx

import sumo_env
from docs import pages, settings
from docs.pages import filled, page_of, templates
from experiments.analysis.plan import DENSEST, LIGHTEST
from experiments.reporting.figures import alone
from experiments.reporting.rare import MEASURED
from experiments.study.design import attainable
from experiments.study.design.sheet import GRID, VARIANTS
from experiments.study.design.traffic import TRAFFICS
from sumo_env.config import COMMON, FIXED, WITHOUT_EFFECT
from sumo_env.contacts.crash import CrashRecord
from sumo_env.scenarios import NetworkTask
from sumo_env.tasks import TASKS
from tests.processes import ROOT, python_again
from tests.tasks import OF_HIGHWAY_ENV, every_task

PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
TEXTS = {page: page.read_text(encoding="utf-8") for page in PAGES}
names = [str(page.relative_to(ROOT)) for page in PAGES]
each_page = pytest.mark.parametrize("page", PAGES, ids=names)
SNIPPETS = [
    pytest.param(block, id=f"{page.relative_to(ROOT)}-{number}")
    for page in PAGES
    for number, block in enumerate(
        re.findall(r"^```python\n(.*?)^```", TEXTS[page], re.DOTALL | re.MULTILINE), 1
    )
]


def section(text: str, title: str) -> str:
    """What stands under a heading, subsections included."""
    found = re.search(rf"^(#+) {re.escape(title)}\n(.*?)(?=^\1 |\Z)", text, re.DOTALL | re.MULTILINE)
    assert found, f"no section {title!r}"
    return found[2]


def table(text: str) -> dict[str, list[str]]:
    """The rows of the first table of a text: first cell -> the other cells, backticks removed from the first."""
    rows = dropwhile(lambda line: not line.startswith("|"), text.splitlines())
    lines = list(takewhile(lambda line: line.startswith("|"), rows))[2:]
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
    return {first.strip("`"): others for first, *others in cells}


def page(name: str) -> str:
    """The text of a page of docs/."""
    return TEXTS[ROOT / "docs" / name]


# -- what is named exists ----------------------------------------------------------------------------------------------


@each_page
def test_ids_commands_and_files_exist(page: Path) -> None:
    text = TEXTS[page]
    assert set(re.findall(r"sumo/[a-z-]+-v\d", text)) <= {
        *sumo_env.IDS,
        *sumo_env.SUMO_TUPLE_IDS,
        sumo_env.SUMO_FAST_ID,
    }
    for file in re.findall(r"python ([\w/.-]+\.py)(?![^`\n]*` at commit )", text):  # what went is named so
        assert (ROOT / file).is_file(), file
    for module in re.findall(r"python -m ([\w.]+)", text):
        assert importlib.util.find_spec(module), module
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    for target in re.findall(r"(?:^    |`)make ([a-z-]+)", text, re.MULTILINE):
        assert re.search(rf"^{target}:", makefile, re.MULTILINE), f"make {target}"

    for path in re.findall(r" (tests/[\w/]+\.py)", text):  # what a command runs
        assert (ROOT / path).is_file(), path
    for path in re.findall(r"`((?:sumo_env|agents|experiments|networks|tests|docs)/[\w/.-]*)`", text):
        assert (ROOT / path).exists(), path


def anchors(text: str) -> set[str]:
    """GitHub's anchors of the headings of a page."""
    headings = re.findall(r"^#+ (.*)$", text, re.MULTILINE)
    return {re.sub(r"[^\w -]", "", heading.lower()).replace(" ", "-") for heading in headings}


@each_page
def test_links_resolve(page: Path) -> None:
    for link in re.findall(r"(?:\]\(|src=\")([^)\s\"]+)", TEXTS[page]):
        if link.startswith(("http://", "https://")):
            continue
        file, _, anchor = link.partition("#")
        target = (page.parent / file).resolve() if file else page
        assert target.exists(), link
        assert page.parent == ROOT or target.is_relative_to(ROOT / "docs"), f"{link} is not on the site"
        if anchor and target.name != "api.md":  # there, mkdocstrings makes the headings
            assert anchor in anchors(target.read_text(encoding="utf-8")), link


@pytest.mark.parametrize("block", SNIPPETS)
@pytest.mark.slow
def test_a_snippet_runs_when_it_is_copied_alone(block: str, tmp_path: Path) -> None:
    short = re.sub(r"learn\(\d+_\d+", "learn(150", block).replace("range(5000, 5100)", "range(5000, 5002)")
    short = short.replace('"duration": 120', '"duration": 20')
    (tmp_path / "snippet.py").write_text(short, encoding="utf-8")
    python_again("-c", "import snippet", cwd=tmp_path)


@pytest.mark.parametrize(("risk", "ending"), [("1.0", "crash"), ("0.0", "time")])
def test_the_readmes_drive_shows_what_risk_does(risk: str, ending: str, tmp_path: Path) -> None:
    script, *_ = re.findall(r"```python\n(.*?)```", section(TEXTS[ROOT / "README.md"], "Drive"), re.DOTALL)
    (tmp_path / "drive.py").write_text(script.replace('"risk": 1.0', f'"risk": {risk}'), encoding="utf-8")
    assert python_again("-c", "import drive", cwd=tmp_path).split() == [ending]
    assert (tmp_path / "drive.gif").is_file()


def test_the_steps_for_a_task_are_the_files_that_name_the_last_one() -> None:
    """Of those that highway-env has, as others take the first part of the steps alone; beside tests."""
    last = OF_HIGHWAY_ENV[-1]
    steps, _, _ = page("developers/extending.md").partition("## A key")
    rooms = "networks", "sumo_env", "agents", "experiments", "tests/golden"
    said = re.findall(rf"`((?:{'|'.join(rooms)})/[\w/.<>-]+)`", steps)
    word = re.compile(rf'"{last}"|\b{last}/|tasks\.{last}\b|import [\w, ]*\b{last}\b|(?<![.\w]){last}\(')
    files = (file for room in rooms for end in ("py", "json") for file in (ROOT / room).rglob(f"*.{end}"))
    found = {file for file in files if last == file.stem or word.search(file.read_text(encoding="utf-8"))}
    folder = ROOT / "networks" / last
    assert {ROOT / name.replace("<name>", last) for name in said} == found | {folder}
    assert len(list(folder.iterdir())) % 4 == 0


def lines_of(file: Path) -> int:
    return sum(bool(line.strip()) for line in file.read_text(encoding="utf-8").splitlines())


def ledger() -> dict[str, int]:
    """Lines that are not blank, by the features of the page: a module's row is the one that names it most exactly."""
    rows, owner = table(section(page("developers/ledger.md"), "By feature")), dict[str, str]()
    for feature, (modules, *_) in rows.items():
        for path in modules.replace("`", "").split():
            start, _, inner = path.rstrip("}").partition("{")
            owner |= {f"{start}{each}": feature for each in inner.split(",")}
    lines = dict.fromkeys(rows, 0)
    rooms, ends = ("networks", "sumo_env", "agents", "experiments"), ("py", "j2", "css")
    for file in (file for room in rooms for end in ends for file in (ROOT / room).rglob(f"*.{end}")):
        path = str(file.relative_to(ROOT))
        lines[owner[max(filter(path.startswith, owner), key=len)]] += lines_of(file)
    return lines


def is_about(said: str, lines: int) -> bool:
    return abs(lines - int(said.replace(",", ""))) <= max(25, 0.15 * lines)


def test_the_risk_of_every_task_is_on_its_page() -> None:
    said = table(section(page("traffic-and-risk.md"), "Risk"))
    rows = {task: row for tasks, row in said.items() for task in tasks.split(", ")}

    def every(rate: float, *how: float) -> str:
        words = " ({:g} m/s² for {:g} s)".format(*how) if how else ""
        return f"{1 / rate:.0f} s{words}" if rate else "-"

    for name, task in TASKS.items():
        rates = task.risk_rates
        brakes = every(rates.brake, rates.brake_decel, rates.brake_duration)
        surges = every(rates.surge, rates.surge_accel, rates.surge_duration)
        assert rows[name] == [every(rates.cut_in), brakes, surges], name


def test_every_module_and_every_folder_of_tests_is_named_with_about_its_lines() -> None:
    features = table(section(page("developers/ledger.md"), "By feature"))
    folders = table(section(page("developers/architecture.md"), "Tests that hold a room"))
    assert [name for name, n in ledger().items() if not is_about(features[name][1], n)] == []
    count = Counter[str]()
    for file in (ROOT / "tests").rglob("*.py"):
        count[str(file.parent.relative_to(ROOT / "tests"))] += lines_of(file)
    assert count.keys() == folders.keys()
    assert [name for name, n in count.items() if not is_about(folders[name][0], n)] == []


# -- what the code has is named ----------------------------------------------------------------------------------------


@every_task
def test_a_task_s_page_names_its_keys_its_levels_and_its_reward(task: str) -> None:
    own, common = page(f"environments/{task}.md"), page("environments/common.md")
    env = gym.make(f"sumo/{task}-v0")
    info = env.reset(seed=0)[1]
    env.close()
    named = set(re.findall(r"`(\w+)`", own + common))
    assert {*COMMON, *TASKS[task].defaults, *info, *info["rewards"]} - named == set()
    levels = [literal_eval(shown) for shown in re.findall(r"`(\{.*?\})`", own)]
    for config in TASKS[task].levels.values():  # so that they can be copied
        assert any(shown == approx(config, rel=1e-5) for shown in levels), config


@pytest.mark.parametrize(
    ("names", "keys"),
    [
        (["collisions.md"], CrashRecord.__dataclass_fields__),
        (["from-highway-env.md"], {*WITHOUT_EFFECT, *FIXED}),
        (["scenarios.md", "own-network.md"], NetworkTask.defaults),
    ],
)
def test_keys_that_users_meet_elsewhere_are_named(names: list[str], keys: Iterable[str]) -> None:
    text = "".join(map(page, [*names, "environments/common.md"]))
    assert set(keys) - set(re.findall(r"`(\w+)`", text)) == set()


each_template = pytest.mark.parametrize("template", templates(), ids=lambda path: path.name)


@each_template
def test_a_page_is_what_its_template_makes_of_the_results(template: Path) -> None:
    page = page_of(template)
    assert TEXTS[page] == filled(template), f"make pages writes {page.relative_to(ROOT)} again"


def test_each_page_that_says_so_has_a_template() -> None:
    made = [page for page in PAGES if TEXTS[page].startswith("<!-- Filled by")]
    assert sorted(made) == sorted(map(page_of, templates())) != []


@each_page
def test_all_lines_of_a_table_have_as_many_cells(page: Path) -> None:
    for rows in re.findall(r"(?:^\|.*\n)+", TEXTS[page], re.MULTILINE):
        assert len({line.count("|") for line in rows.splitlines()}) == 1, rows


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
    [file] = (ROOT / "results" / "study-6" / "parts").glob(f"sumo-{setting}-{arm}-*.parquet")
    rows = pq.read_table(file).to_pylist()
    mine = [row for row in rows if (row["purpose"], row["traffic"]) == ("test", traffic)]
    return [row for row in mine if not re.search("-on-replica-|-unseen-", row["cell"])]


def test_numbers_of_the_study_are_those_of_its_stored_episodes() -> None:
    """Of a task the mean over its settings."""
    place = {"scope": "u-turn", "traffic": "regular", "tested_on": "sumo"}
    close, near_misses = list[float](), list[float]()
    for _, level in DENSEST[-1:] + LIGHTEST[-1:]:
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
    assert sum(arm["passed"] for arm in arms) == pages.failing()["passed"] and arms[0]["of"] == 50
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
    assert of["risky", "less"] == {"highway", "roundabout", "intersection", "u-turn"}
    assert of["regular", "more"] == {"highway", "two-way", "intersection"}
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
