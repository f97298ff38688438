"""The report: complete, self-contained, the same for the same cells, and readable when results are not complete."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from experiments.reporting.beside import beside
from experiments.reporting.card import card
from experiments.reporting.report_view import effect_rows, pooled_rows, validation

from experiments import report
from experiments.analysis.analysis import analyse
from experiments.analysis.plan import OUTCOMES
from experiments.analysis.wording import difference
from experiments.reporting import figures
from experiments.reporting.collision_figures import LENGTH, WIDTH, collisions, contacts, corners
from experiments.study import store
from experiments.study.results import load
from experiments.study.verdict import SCHEMA
from experiments.support.errors import UserError
from tests.experiments import synthetic

SCRIPT = Path(report.__file__)
VOID = {"meta", "br", "link", "hr", "img", "input"}


class Page(HTMLParser):
    """Collects what a report is checked for; raises where tags do not match."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.ids: list[str] = []
        self.links: list[str] = []
        self.sources: list[str] = []
        self.tags: list[str] = []
        self.open: list[str] = []
        self.text = ""
        self.feed(text)
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        values = dict(attrs)
        if "id" in values:
            self.ids.append(values["id"])
        if tag == "a":
            self.links.append(values.get("href", ""))
        self.sources += [values[name] for name in ("src", "xlink:href", "data") if name in values]
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.handle_starttag(tag, attrs)
        if tag not in VOID:
            self.open.pop()

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open[-1:] not in (["style"], ["script"]):
            self.text += data


def write(directory: Path, *args, **kwargs) -> Page:
    synthetic.write(directory, *args, **kwargs)
    return Page(report.write_report(directory).read_text())


@pytest.fixture(scope="module")
def directory(tmp_path_factory):
    home = tmp_path_factory.mktemp("results")
    faults = {"sumo-u-turn-6-control-s0": "diverged"}
    synthetic.write(home, {"intersection": (1,), "u-turn": (1, 2)}, seeds=4, tests=10, faults=faults)
    report.write_report(home)
    return home


@pytest.fixture(scope="module")
def page(directory):
    return Page((directory / "report.html").read_text())


class TestReport:
    def test_all_files_are_written(self, directory):
        value = json.loads((directory / "analysis.json").read_text(), parse_constant=pytest.fail)
        assert {"ate", "claims", "gates", "policies", "provenance"} <= set(value)
        table = pd.read_csv(directory / "summary.csv")
        assert len(table) == 3 * 8 * 2
        assert {"backend", "task", "level", "policy", "arm", "traffic", "return", "crashed"} <= set(
            table.columns
        )

    def test_the_answer_comes_in_three_sentences_also_as_text(self, directory, page):
        (headline,) = json.loads((directory / "analysis.json").read_text())["headlines"]
        text = (directory / "report.md").read_text()
        for sentence in headline["text"]:
            assert sentence in page.text and sentence in text
        assert "risky traffic" in headline["text"][0] and "points [" in headline["text"][0]
        assert "In regular traffic" in headline["text"][1]
        assert "Of the paper's claims" in headline["text"][2]
        assert "{" not in text and "None" not in text

    def test_effects_are_written_as_a_table(self, directory):
        table = pd.read_csv(directory / "effects.csv")
        assert set(table["term"]) == {"risky", "regular", "sum", "interaction"}
        assert set(table["family"].dropna()) == {"safety", "paper"}
        rows = table.query("outcome == 'crashed' and term == 'risky'")
        assert len(rows) == 3
        assert rows["estimate"].tolist() == pytest.approx(
            (rows["mean_treatment"] - rows["mean_control"]).tolist()
        )

    def test_needs_nothing_else(self, directory, page):
        text = (directory / "report.html").read_text()
        assert "link" not in page.tags and "img" not in page.tags
        assert all(source.startswith(("#", "data:")) for source in page.sources)
        assert not re.findall(r"""(?:src|href)=["'](?:https?:)?//""", text)
        assert "@import" not in text
        assert all(link.startswith(("#", "cells/")) for link in page.links)

    def test_every_link_leads_somewhere(self, directory, page):
        assert len(page.ids) == len(set(page.ids))
        for link in page.links:
            if link.startswith("#"):
                assert link[1:] in page.ids
            else:
                assert (directory / link).exists()

    def test_every_cell_is_listed(self, directory, page):
        for cell in load(directory).cells:
            assert cell in page.ids

    def test_sections_are_there(self, page):
        for words in (
            "What was run", "Is the simulator right?", "Claims of the paper", "Average treatment effects",
            "Learning curves".lower(), "Collisions", "Near-misses", "Q-values", "How every policy drives",
            "Are the agents worth comparing?", "How it was computed", "as it is printed", "mark to beat",
            "Does the instrument work?", "the largest effect of any kind is 0, as it has to be",
            "More than the paper", "How far does the answer hold?", "Watch them drive",
            "Does the answer hang on a choice?",
        ):  # fmt: skip
            assert words in page.text

    def test_films_that_cannot_be_shown_are_named(self, page):
        assert "There are no films here" in page.text
        assert "intersection 10: the agents could not be replayed" in page.text

    def test_agents_that_fail_are_named_and_counted(self, page):
        assert "1 of 4 control agents fail (1 diverged" in page.text
        assert "The share of agents that fail, as an outcome" in page.text

    def test_a_reason_is_said_once_in_a_row(self, directory):
        analysis = json.loads((directory / "analysis.json").read_text())
        for outcome in ("return", "crashed"):
            for row in effect_rows(analysis["ate"], outcome):
                assert len(row["reasons"]) == len(set(row["reasons"]))
                assert sum("control agents fail" in reason for reason in row["reasons"]) <= 1

    def test_means_are_over_all_settings(self, directory):
        analysis = json.loads((directory / "analysis.json").read_text())
        rows = {row["scope"]: row for row in pooled_rows(analysis["pooled"], "crashed")}
        assert set(rows) == {"u-turn", "all tasks"}
        assert rows["all tasks"]["comparisons"] == [3, 3]

    def test_is_the_same_for_the_same_cells(self, directory):
        names = ("report.html", "report.md", "analysis.json", "summary.csv", "effects.csv")
        before = [(directory / name).read_bytes() for name in names]
        report.write_report(directory)
        assert [(directory / name).read_bytes() for name in names] == before

    def test_nothing_undefined_or_not_a_number_is_shown(self, page):
        assert not re.search(r"\b(nan|None|inf|undefined)\b", page.text)

    def test_is_no_smoke_test(self, page):
        assert "Smoke test" not in page.text


class TestCard:
    """What the paper says, what was done here, and whether that is the same."""

    def rows(self, directory, **settings):
        synthetic.write(directory, {"u-turn": (1,)}, seeds=3, tests=8, **settings)
        results = load(directory)
        return {row["topic"]: row for row in card(analyse(results), results.cells)}

    def test_names_the_error_of_the_formula_and_that_there_are_no_numbers(self, tmp_path):
        rows = self.rows(tmp_path)
        assert "the last sign is an error" in rows["Formula of the effect"]["paper"]
        assert "no table of numbers" in rows["Numbers"]["paper"]
        assert {row["same"] for row in rows.values()} <= {"same", "in part", "different", "not decided"}

    def test_follows_what_was_run(self, tmp_path):
        rows = self.rows(tmp_path / "sumo")
        assert rows["Simulator"]["same"] == "different" and "SUMO" in rows["Simulator"]["here"]
        assert "1 of the same 18" in rows["Tasks and traffic"]["here"]
        assert "3 training seeds per arm" in rows["Repetition"]["here"]
        rows = self.rows(tmp_path / "replica", backend="replica")
        assert rows["Simulator"]["same"] == "same"

    def test_every_claim_of_the_paper_has_its_verdict(self, tmp_path):
        rows = self.rows(tmp_path)
        assert sum(topic.startswith("Result: ") for topic in rows) == 3


class TestSideBySide:
    def test_directories_are_shown_by_what_they_have_in_common(self, tmp_path):
        own, second, third = tmp_path / "own", tmp_path / "second", tmp_path / "third"
        synthetic.write(own, {"highway": (1, 2), "u-turn": (1,)}, seeds=3, tests=10)
        synthetic.write(second, {"highway": (1,), "u-turn": (1, 2)}, seeds=5, tests=10, backend="replica")
        synthetic.write(third, {"u-turn": (1,)}, seeds=3, tests=10)
        page = Page(report.write_report(own, second, third).read_text())
        assert f"{second} (the replica): On the replica, it is not decided" in page.text
        assert "5 training seeds in each arm, 3 settings." in page.text
        assert "neither show nor exclude" in page.text
        assert len(page.ids) == len(set(page.ids))
        text = (own / "report.md").read_text().partition("## Side by side")[2].partition("## ")[0]
        rows = [line.split(" | ") for line in text.splitlines() if line.startswith("| ")]
        risky = next(k for k, row in enumerate(rows) if row[0] == "| crash rate in risky traffic")
        assert [row[0] for row in rows[risky + 1 : risky + 4]] == [
            "| highway 50",
            "| u-turn 3",
            "| all tasks",
        ]
        assert [row[3] == "– |" for row in rows[risky + 1 : risky + 4]] == [True, False, True]

    def test_the_mean_is_that_of_the_settings_in_common(self, tmp_path):
        own, other = tmp_path / "own", tmp_path / "other"
        synthetic.write(own, {"highway": (1, 2), "u-turn": (1,)}, seeds=3, tests=10)
        synthetic.write(other, {"highway": (1,), "u-turn": (1,)}, seeds=3, tests=10)
        analyses = [(name, analyse(load(home))) for name, home in (("own", own), ("other", other))]
        [section] = beside(analyses)
        mean = section["tables"][0]["rows"][-1]["effects"][1]
        [primary] = [r for r in analyses[1][1]["pooled"] if r["primary"]]
        assert mean == difference(primary, "crashed")

    def test_nothing_is_shown_without_a_setting_in_common(self, tmp_path):
        own, other = tmp_path / "own", tmp_path / "other"
        synthetic.write(own, {"highway": (1,)}, seeds=3, tests=4)
        synthetic.write(other, {"u-turn": (1,)}, seeds=3, tests=4)
        assert "Side by side" not in Page(report.write_report(own, other).read_text()).text

    def test_a_run_is_shown_beside_the_published_study_and_that_beside_its_variants(
        self, tmp_path, monkeypatch
    ):
        study, variant, own = tmp_path / "standard", tmp_path / "replica", tmp_path / "own"
        monkeypatch.setattr(report, "PUBLISHED", study)
        synthetic.write(study, {"u-turn": (1,)}, seeds=5, tests=10, preset="standard")
        (study / store.PUBLISHED).write_text("# The published study\n\nWords.\n")
        assert "Side by side" not in report.write_report(study).read_text()
        synthetic.write(own, {"u-turn": (1,)}, seeds=1, tests=4, preset="smoke")
        page = Page(report.write_report(own).read_text())
        assert "The published study: On SUMO" in page.text
        assert "One training seed in an arm cannot tell anything" in page.text
        synthetic.write(variant, {"u-turn": (1,)}, seeds=4, tests=10, backend="replica")
        (variant / store.PUBLISHED).write_text("# The study on the replica\n")
        assert "The published study (SUMO): On SUMO" in Page(report.write_report(variant).read_text()).text
        page = Page(report.write_report(study).read_text())
        assert "The study on the replica: On the replica" in page.text
        (study / "analysis.json").write_text('{"schema": 0}')
        assert "Side by side" not in report.write_report(own).read_text()


def test_a_damaged_analysis_of_another_directory_is_named(tmp_path, capsys):
    damaged = tmp_path / report.ANALYSIS
    damaged.write_text('{"schema": ')
    assert report._stored(damaged) is None
    assert f"{damaged} is damaged" in capsys.readouterr().err


class TestIncomplete:
    """Results as they are while a sweep runs, or after one with little in it."""

    def test_smoke_preset_is_no_evidence(self, tmp_path):
        page = write(tmp_path, {"u-turn": (1,)}, seeds=1, tests=4, preset="smoke")
        assert "Smoke test" in page.text and "no evidence" in page.text
        assert "Only one training seed" in page.text
        assert "no interval" in page.text

    def test_one_arm(self, tmp_path):
        page = write(tmp_path, {"u-turn": (1,)}, seeds=2, tests=4, arms=("treatment",))
        assert "No control agents" in page.text
        assert "2 cells that a sweep has asked for are missing" in page.text

    def test_further_arms_are_drawn_and_told(self, tmp_path):
        page = write(tmp_path, {"u-turn": (1,)}, seeds=2, tests=8, further=("dense", "dose50"))
        start = page.text.index("Further arms")
        told = page.text[start : page.text.index("On another simulator", start)]
        assert all(name in told for name in ("risk at dose .5", "risk at dose 1", "denser, no risk"))
        assert "mean of" not in told  # one setting is no mean

    def test_no_agents(self, tmp_path):
        page = write(tmp_path, {"u-turn": (1,)}, tests=4, arms=(), sweep=False)
        assert "No trained agents" in page.text
        assert "no claim can be judged" in page.text

    def test_no_baselines_and_the_reference_alone(self, tmp_path):
        page = write(tmp_path, {"two-way": (1,)}, seeds=2, tests=4, baselines=(), backend="highway-env")
        assert "No baselines" in page.text
        assert "highway-env is the reference itself" in page.text

    def test_on_the_two_way_road_the_time_to_crash_is_tested(self, tmp_path):
        page = write(tmp_path, {"two-way": (1,), "u-turn": (1,)}, seeds=3, tests=8)
        assert page.text.count("exploratory on this task") == 2  # crashes there, the time to crash elsewhere

    def test_failed_cells_are_named(self, tmp_path):
        cells = synthetic.write(tmp_path, {"u-turn": (1,)}, seeds=1, tests=4, baselines=("idle",))
        home = store.Store(tmp_path)
        lost = cells[0].name
        home.put_aside(home.cells / lost)
        home.write_failure(lost, "the <simulator> died", f"python experiments/sweep.py --cell {lost}")
        page = Page(report.write_report(tmp_path).read_text())
        assert f"{lost} (the <simulator> died)" in page.text

    def test_a_missing_directory_is_said_so(self, tmp_path):
        with pytest.raises(UserError, match="no results"):
            report.write_report(tmp_path / "nowhere")
        (tmp_path / "cells").mkdir()
        with pytest.raises(UserError, match="no finished cell"):
            report.write_report(tmp_path)


class TestValidation:
    def test_is_shown_with_what_was_missed(self, tmp_path):
        counts = {"equivalent": 6, "within": 2, "missed": 0}
        missed = [{"name": "crash rate", "ego": "idle"}]
        tasks = {
            "highway": {"passed": True, "counts": counts, "missed": []},
            "u-turn": {"passed": False, "counts": {**counts, "missed": 1}, "missed": missed},
        }
        shown = self.with_file(tmp_path, {"schema": SCHEMA, "source": "a quick look", "tasks": tasks})
        verdicts = {row["task"]: (row["verdict"], row["reason"]) for row in shown["tasks"]}
        assert verdicts["highway"] == ("passed", "8 of 8 checks within their margins")
        assert verdicts["u-turn"] == ("failed", "8 of 9 checks within their margins; not: crash rate idle")
        assert verdicts["roundabout"] == ("not validated", "")
        assert "Not validated: two-way, roundabout and intersection" in shown["note"]
        assert shown["source"] == "a quick look"

    @pytest.mark.parametrize("value", [[1], {"schema": 1, "tasks": {}}, {"tasks": {"highway": {}}}])
    def test_that_cannot_be_read_does_not_count(self, tmp_path, value):
        assert {row["verdict"] for row in self.with_file(tmp_path, value)["tasks"]} == {"not validated"}

    def test_is_no_question_for_the_reference(self, tmp_path):
        assert not validation(tmp_path, ["highway-env"])["relevant"]

    @staticmethod
    def with_file(directory, value):
        (directory / "validation.json").write_text(json.dumps(value))
        return validation(directory, ["sumo"])


class TestCommand:
    @staticmethod
    def run(*arguments, cwd):
        return subprocess.run(
            [sys.executable, str(SCRIPT), *arguments], cwd=cwd, capture_output=True, text=True, timeout=300
        )

    def test_placebo_is_printed_and_nothing_written(self, directory, tmp_path):
        written = (directory / "report.html").stat().st_mtime_ns
        done = self.run(str(directory), "--placebo", cwd=tmp_path)
        assert done.returncode == 0, done.stderr
        assert "of 3 settings significant" in done.stdout
        assert "largest effect 0" in done.stdout
        assert (directory / "report.html").stat().st_mtime_ns == written

    def test_works_from_anywhere(self, directory, tmp_path):
        done = self.run(str(directory), cwd=tmp_path)
        assert done.returncode == 0, done.stderr
        assert str(directory / "report.html") in done.stdout
        assert "not decided" in done.stdout

    def test_says_what_to_do_in_one_line(self, tmp_path):
        done = self.run("nowhere", cwd=tmp_path)
        assert done.returncode == 2
        assert done.stderr.count("\n") == 1
        assert "nowhere holds no results" in done.stderr and "--out" in done.stderr
        assert done.stdout == ""


class TestFigures:
    def test_colours_follow_the_page(self, directory):
        results = load(directory)
        agents = {k: v for k, v in results.cells.items() if v["key"]["task"] == "u-turn" and v.get("learner")}
        drawn = figures.learning_curves(agents, "u-turn")
        assert drawn.startswith("<svg role")
        assert f"var(--control, {figures.CONTROL})" in drawn
        assert re.search(r"(?<!, )" + figures.CONTROL, drawn) is None
        assert "<dc:date>" not in drawn

    def test_ids_carry_the_name_of_the_figure(self, directory):
        drawn = collisions(load(directory).episodes)
        ids = re.findall(r'\bid="([^"]+)"', drawn)
        assert ids and all(name.startswith("sumo-collisions-") for name in ids)
        references = set(re.findall(r'(?:url\(|href=")#([^")]+)', drawn))
        assert references <= set(ids)

    def test_unknown_types_of_crash_are_shown_as_such(self, directory):
        episodes = load(directory).episodes
        drawn = collisions(episodes.assign(crash_type=pd.Series(pd.NA, index=episodes.index, dtype="str")))
        assert "not recorded" in drawn


class TestContacts:
    """Where two vehicles touch, in the ego's frame."""

    @pytest.mark.parametrize(
        ("pose", "expected"),
        [
            ((LENGTH, 0.0, 0.0), (LENGTH / 2, 0.0)),  # bumper to bumper, other ahead
            ((-LENGTH, 0.0, 0.0), (-LENGTH / 2, 0.0)),  # struck from behind
            ((0.0, WIDTH, 0.0), (0.0, WIDTH / 2)),  # side by side, other on the right
            ((LENGTH / 2 + WIDTH / 2, 0.0, np.pi / 2), (LENGTH / 2, 0.0)),  # into the flank of a crossing car
            ((LENGTH + 0.4, 0.0, 0.0), (LENGTH / 2 + 0.4, 0.0)),  # only near: the closest side of the other
        ],
    )
    def test_of_two_vehicles(self, pose, expected):
        x, y, heading = (np.array([value]) for value in pose)
        assert contacts(x, y, heading)[0] == pytest.approx(expected, abs=0.05)

    def test_lie_within_the_ego_where_vehicles_overlap(self):
        random = np.random.default_rng(0)
        x, y, heading = (
            random.uniform(-3.2, 3.2, 200),
            random.uniform(-0.9, 0.9, 200),
            random.uniform(-3, 3, 200),
        )
        found = contacts(x, y, heading)
        assert (np.abs(found) <= np.array([LENGTH / 2, WIDTH / 2]) + 0.01).all()

    def test_corners_of_a_turned_vehicle(self):
        shape = corners(np.array([1.0]), np.array([2.0]), np.array([np.pi / 2]))[0]
        assert shape.mean(axis=0) == pytest.approx([1.0, 2.0])
        assert np.ptp(shape, axis=0) == pytest.approx([WIDTH, LENGTH])


OWN = """
from experiments.analysis.plan import Outcome
waiting = Outcome("Time at a standstill", "share", better=-1, digits=3, of=lambda episodes: episodes["stopped"])
nothing = Outcome("Nothing", "", better=0, digits=1)
"""


def test_an_outcome_of_the_user_s_own_is_analysed(tmp_path):
    """As an exploratory one: what decides is fixed."""
    (tmp_path / "mine.py").write_text(OWN)
    synthetic.write(tmp_path, {"u-turn": (1,)}, tests=6)
    before = json.loads((report.write_report(tmp_path).parent / report.ANALYSIS).read_text())
    try:
        report.add_outcome(f"{tmp_path}/mine.py:waiting")
        with pytest.raises(UserError, match="already"):
            report.add_outcome(f"{tmp_path}/mine.py:waiting")
        page = Page(report.write_report(tmp_path).read_text())
    finally:
        del OUTCOMES["waiting"]
    after = json.loads((tmp_path / report.ANALYSIS).read_text())
    rows = [row for row in after["ate"] if row["outcome"] == "waiting"]
    assert rows and {row["family"] for row in rows} == {None}
    assert {row["status"] for row in rows} & {"ok", "degenerate"}
    assert [row for row in after["ate"] if row["outcome"] == "crashed"] == [
        row for row in before["ate"] if row["outcome"] == "crashed"
    ]
    assert after["plan"]["outcomes"]["waiting"]["label"] == "Time at a standstill" in page.text


@pytest.mark.parametrize(
    ("name", "message"), [("nothing", "function `of`"), ("nobody", "defines no"), ("OWN.py", "FILE:NAME")]
)
def test_an_outcome_that_is_none_is_refused(name, message, tmp_path):
    (tmp_path / "mine.py").write_text(OWN)
    target = name if name == "OWN.py" else f"{tmp_path}/mine.py:{name}"
    with pytest.raises(UserError, match=message):
        report.add_outcome(target)
