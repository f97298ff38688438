"""The report: complete, self-contained, the same for the same cells, and readable when results are not complete."""

import json
import re
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from experiments import report
from experiments.analysis import estimate
from experiments.analysis.analysis import DESCRIPTIVE, Analysis, analyse, policies
from experiments.analysis.by_task import COLUMNS
from experiments.analysis.effects import ESTIMATE, MEANS, WORKING_COLUMNS, means
from experiments.analysis.plan import OUTCOMES
from experiments.reporting.by_task import both_arms
from experiments.reporting.tables import MINUS, difference, main
from experiments.reporting.takeover import skill_or_caution
from experiments.study.compute import takeover
from experiments.study.design import attainable
from experiments.study.design.verdict import STORED
from experiments.study.results.loaded import load
from experiments.study.results.parquet import DamagedEpisodes, write_part
from experiments.support.errors import UserError
from tests.experiments import synthetic
from tests.experiments.analysis.test_takeover import alike, drawn

VOID = {"meta", "br", "link", "hr", "img", "input"}


class Page(HTMLParser):
    """Tags, attributes and words of a page; raises where tags do not match."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.attributes: list[tuple[str, str]] = []
        self.open: list[str] = []
        self.text = ""
        self.feed(text)
        assert self.open == []

    def values(self, *names: str) -> list[str]:
        return [value for name, value in self.attributes if name in names]

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.attributes += attrs
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert tag in VOID or self.open.pop() == tag

    def handle_data(self, data):
        if self.open[-1:] not in (["style"], ["script"]):
            self.text += data


def write(directory: Path, *args, **kwargs) -> Page:
    synthetic.write(directory, *args, **kwargs)
    return Page(report.write_report(directory).read_text())


def reported(*directories: Path, **asked) -> list[Analysis]:
    """Write a report; the analyses that it is made of, one a directory."""
    made: list[Analysis] = []

    def kept(*given) -> Analysis:
        made.append(analyse(*given))
        return made[-1]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(report, "analyse", kept)
        report.write_report(*directories, **asked)
    return made


@pytest.fixture(scope="module")
def directory(tmp_path_factory):
    home = tmp_path_factory.mktemp("results")
    levels, more = {"intersection": (1,), "u-turn": (1, 2)}, ("told", "dose50")
    synthetic.write(home, levels, seeds=4, tests=10, diverged="sumo-u-turn-6-control-s0", further=more)
    return home


@pytest.fixture(scope="module")
def analysis(directory) -> Iterator[Analysis]:
    values = {"IDLE": ("constant", 1.0, 0.5), "planner": ("policy", 9.0, 0.0)}
    drivers = {name: dict(zip(("kind", "return", "crashed"), of, strict=True)) for name, of in values.items()}
    with pytest.MonkeyPatch.context() as patch:
        places = [f"intersection 10 {traffic}" for traffic in ("regular", "risky")]
        known: dict[str, Any] = {place: {"drivers": drivers} for place in places}
        known |= {f"{name} regular": {"search": {"no_safe": 0.9}} for name in ("u-turn 6", "u-turn 12")}
        patch.setattr(attainable, "stored", lambda: known)
        yield reported(directory)[0]


@pytest.mark.usefixtures("analysis")
class TestReport:
    def test_all_drivers_are_in_the_summary_and_in_the_appendix(self, directory):
        table = pd.read_csv(directory / "summary.csv")
        assert all((table["traffic"] == traffic).sum() == 3 * 10 for traffic in ("regular", "risky"))
        assert {"backend", "task", "level", "policy", "arm", "traffic", "return", "crashed"} <= set(table)
        text = Page((directory / "appendix.html").read_text()).text
        assert "told" in text and "dose50" in text

    def test_scores_stand_beside_returns_and_what_cannot_be_driven_is_named(self, directory):
        for name in ("report.html", "report.md"):
            text = (directory / name).read_text()
            assert "score" in text and text.count("Score: 0 is the best constant action") == 1
            assert "On u-turn 6 no sequence of actions" in text and "u-turn 12" not in text
        appendix = (directory / "appendix.html").read_text()
        assert (
            "Can they drive? The control agents of 0 of 1 settings can"
            in (directory / "report.html").read_text()
        )
        assert "score, risky" in appendix and "score, regular" in appendix

    def test_analysis_json_has_all_frames(self, directory, analysis):
        value = json.loads((directory / "analysis.json").read_text(), parse_constant=pytest.fail)
        for name in ("means", "claims", "gates", "slopes", "policies", "learner"):
            again = pd.DataFrame(value[name]["rows"], columns=value[name]["columns"])
            again = again.astype(getattr(analysis, name).dtypes)
            pd.testing.assert_frame_equal(again, getattr(analysis, name), rtol=1e-11)
        assert len(value["effects"]["rows"]) == len(analysis.effects) > 0
        assert value["plan"] == analysis.plan and value["provenance"]["hash"] == analysis.provenance["hash"]

    def test_a_check_of_sumo_that_is_missed_stands_with_sumo_s_number_first(self, directory):
        stored, text = json.loads(STORED.read_text()), (directory / report.REPORT).read_text()
        for item in stored["u-turn"]["outside"] + stored["intersection"]["outside"]:
            assert f"{item['sumo']:.3g} instead of {item['reference']:.3g}" in text

    @pytest.mark.parametrize("name", ["report.html", "appendix.html"])
    def test_needs_nothing_else(self, directory, name):
        text = (directory / name).read_text()
        page = Page(text)
        assert "link" not in page.tags and "img" not in page.tags
        assert all(source.startswith(("#", "data:")) for source in page.values("src", "xlink:href", "data"))
        assert "@import" not in text and not re.findall(r"""src=["'](?:https?:)?//""", text)
        assert len(page.values("id")) == len(set(page.values("id")))
        pages = [link for link in page.values("href") if not link.startswith("https://arxiv.org/")]
        assert all((directory / link).exists() for link in pages)
        assert not re.search(r"\b(nan|None|inf|undefined)\b|{[{%]", page.text)

    def test_is_the_same_for_the_same_cells(self, directory):
        names = ("report.html", "appendix.html", "report.md", "analysis.json", "summary.csv", "effects.csv")
        before = [(directory / name).read_bytes() for name in names]
        report.write_report(directory)
        assert [(directory / name).read_bytes() for name in names] == before


class TestAnswer:
    """Numbers of the answer stand where they belong: risky with risky, treated with treated."""

    @pytest.fixture(scope="class")
    @classmethod
    def analysis(cls, tmp_path_factory, words_alone):
        home = tmp_path_factory.mktemp("answer")
        synthetic.write(home, {"highway": (1,), "u-turn": (1, 2)}, seeds=6, tests=60, effect=-0.4)
        [found] = reported(home)
        return found, Page((home / report.REPORT).read_text()).text, (home / report.TEXT).read_text()

    def test_the_first_sentence_says_what_holds_in_which_task(self, analysis):
        found, page, text = analysis
        rows = found.by_task.query(
            "outcome == 'crashed' and arm == 'treatment' and scope in ('highway', 'u-turn')"
        )
        assert (rows.query("traffic == 'risky'")["high"] < 0).all()  # as planted
        first = text.splitlines()[2].strip("*")
        assert first.startswith(
            "In risky traffic treated agents: fewer crashes on highway and u-turn. In regular"
        )
        assert first in page
        regular = rows.query("traffic == 'regular'")
        assert ((regular["low"] < 0) & (regular["high"] > 0)).all()
        assert first.endswith("not decided on highway and u-turn.")

    @pytest.mark.parametrize("traffic", ["risky", "regular"])
    def test_the_last_tables_have_both_arms_and_the_difference_of_each_task(self, analysis, traffic):
        found, _, text = analysis
        shown = found.by_task[found.by_task["outcome"].isin([*COLUMNS])]
        for row in shown.query("traffic == @traffic and scope == 'u-turn'").to_dict("records"):
            assert both_arms(row).replace("\n", ": ") in text


@pytest.mark.usefixtures("words_alone")
def test_folders_side_by_side_are_compared_in_the_settings_of_all(tmp_path):
    own, other = tmp_path / "own", tmp_path / "other"
    size: dict[str, Any] = {"seeds": 3, "tests": 10, "baselines": ("careful",)}
    synthetic.write(own, {"highway": (1, 2), "u-turn": (1,)}, **size)
    synthetic.write(other, {"highway": (1,), "u-turn": (1,)}, **size, backend="replica")
    synthetic.write(
        other, {"u-turn": (1,)}, **size, backend="sumo"
    )  # a second simulator, which is not compared
    ours, theirs = reported(own, other)
    text = Page((own / report.REPORT).read_text()).text
    elsewhere = main(theirs.means, "replica").query("scope == 'all tasks' and outcome == 'crashed'")
    both = ours.effects.query("level == 1 and outcome == 'crashed' and arm == 'treatment'")
    for term in ("risky", "regular"):
        [there] = elsewhere[elsewhere["term"] == term].to_dict("records")
        alone = means(main(both[both["term"] == term], "sumo")).query("scope == 'all tasks'")
        assert difference(there) in text and difference(alone.iloc[0]) in text
        arms = [
            (crashes(folder, arm, term), outer * inner)
            for folder, outer in ((other, 1.0), (own, -1.0))
            for arm, inner in (("treatment", 1.0), ("control", -1.0))
        ]
        floor = sum(estimate.binomial_floor([scores]) for scores, _ in arms)
        assert difference(estimate.interval(estimate.linear(arms, floor))._asdict()) in text


def crashes(folder: Path, arm: str, traffic: str) -> np.ndarray:
    """Of the agents of u-turn, by seed and scenario."""
    rows = load(folder).episodes.query("task == 'u-turn' and arm == @arm and traffic == @traffic")
    rows = rows[rows["backend"] == rows["backend"].min()]
    return rows.sort_values(["seed", "scenario"])["crashed"].to_numpy(float).reshape(3, 10)


@pytest.mark.usefixtures("words_alone")
def test_numbers_are_numbers_also_where_there_is_one_seed(tmp_path):
    """Empty frames among those that are put together would make objects of them, whose 0 / 0 is an error."""
    synthetic.write(tmp_path / "own", {"u-turn": (1,)}, seeds=1, tests=4)
    synthetic.write(tmp_path / "other", {"u-turn": (1,)}, seeds=1, tests=4, backend="replica")
    effects = reported(tmp_path / "own", tmp_path / "other")[0].effects
    assert {effects[name].dtype.kind for name in (*ESTIMATE[:-1], *MEANS, *WORKING_COLUMNS)} == set("fi")


def test_the_severity_of_unseen_crashes_is_the_mean_over_crashes_alone():
    """Of each agent first, then of the agents; drives without a crash have no closing speed."""
    drives = pd.DataFrame({"cell": [1, 1, 1, 2], "crash_closing_speed": [4.0, 8.0, np.nan, 10.0]})
    episodes = drives.assign(
        backend="sumo", tested_on="sumo", task="u-turn", level=1, level_name="3", kind="agent", policy="dqn",
        arm="control", seed=drives["cell"], traffic="krauss", scenario=0, seconds=10.0,
        **dict.fromkeys({*OUTCOMES, *DESCRIPTIVE} - {"crash_closing_speed"}, 1.0),
    )  # fmt: skip
    assert policies(episodes)["crash_closing_speed"].tolist() == [8.0]


@pytest.mark.usefixtures("words_alone")
class TestIncomplete:
    """Results as they are while a sweep runs, or after one with little in it."""

    @pytest.mark.parametrize(
        ("made_up", "word"),
        [
            ({"seeds": 1, "preset": "smoke"}, "no evidence"),
            ({"arms": ("treatment",)}, "2 cells that a sweep has asked for are missing"),
            # as where all agents have diverged
            ({"seeds": 1, "arms": ()}, "no agents of both arms to compare"),
        ],
        ids=str,
    )
    def test_what_is_not_there_is_no_answer(self, made_up, word, tmp_path):
        page = write(tmp_path, {"u-turn": (1,)}, **{"seeds": 2, "tests": 4, **made_up})
        assert word in page.text and "No answer" in report.answer(tmp_path)
        assert "|" not in (tmp_path / "report.md").read_text()  # no table without rows

    def test_failed_and_damaged_cells_are_named(self, tmp_path):
        cells = synthetic.write(tmp_path, {"u-turn": (1,)}, seeds=2, tests=4)
        [name] = [
            cell.name for cell in cells if cell.kind == "agent" and (cell.arm, cell.seed) == ("treatment", 1)
        ]
        (tmp_path / "cells" / f"{name}.parquet").write_bytes(b"no table")
        text = report.write_report(tmp_path).read_text()
        assert "cannot be read and are not counted" in Page(text).text and name in Page(text).text
        assert "&lt;" not in text  # the page's own tags


OWN = """
from experiments.analysis.plan import Outcome
waiting = Outcome("Time at a standstill", "share", better=-1, digits=3, of=lambda episodes: episodes["stopped"])

closing = Outcome("Closing speed", "m/s", -1, 1, of=lambda episodes: episodes["crash_closing_speed"])
few = Outcome("Few", "", 0, 1, of=lambda episodes: [1.0])
words = Outcome("Words", "", 0, 1, of=lambda episodes: episodes["traffic"])
absent = Outcome("Absent", "", 0, 1, of=lambda episodes: episodes["absent"])

"""


@pytest.mark.usefixtures("words_alone")
def test_an_outcome_of_the_user_s_own_is_analysed(tmp_path):
    """As an exploratory one: what decides is fixed."""
    (tmp_path / "mine.py").write_text(OWN)
    synthetic.write(tmp_path, {"u-turn": (1,)}, tests=6, baselines=("careful",))
    before = analyse(load(tmp_path))
    name, outcome = report.own_outcome(f"{tmp_path}/mine.py:waiting")
    [after] = reported(tmp_path, own={name: outcome})
    own = after.effects[after.effects["outcome"] == "waiting"]
    assert len(own) and set(own["family"]) == {""}
    assert set(own["status"]) & {"ok", "degenerate"}
    crashes = [
        found.effects.query("outcome == 'crashed'").reset_index(drop=True) for found in (after, before)
    ]
    pd.testing.assert_frame_equal(*crashes)
    assert after.plan == before.plan and after.plan_hash == before.plan_hash
    assert "waiting" in set(after.means["outcome"]) and "waiting" in after.policies
    again = analyse(load(tmp_path))
    pd.testing.assert_frame_equal(again.effects, before.effects)
    assert "own" not in report.answer(tmp_path)  # a heading without its table
    for page in (report.REPORT, report.TEXT):
        assert "Time at a standstill share" in (tmp_path / page).read_text()


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("closing", r"closing is nan in scenario \d+ of"),
        ("few", "few has the shape"),
        ("words", "words cannot be computed: ValueError"),
        ("absent", "absent cannot be computed: KeyError"),
    ],
)
def test_an_outcome_that_is_no_number_for_each_episode_is_refused(name, message, directory, tmp_path):
    (tmp_path / "mine.py").write_text(OWN)
    with pytest.raises(UserError, match=message):
        report.write_report(directory, own=dict([report.own_outcome(f"{tmp_path}/mine.py:{name}")]))


def test_skill_and_caution_stand_in_the_report_of_a_study_whose_pairs_were_driven(tmp_path: Path) -> None:
    synthetic.write(tmp_path, {"u-turn": (1,)}, seeds=2)
    random = np.random.default_rng(1)
    rows = [
        drawn(random, (alike, lambda _: {"danger": 0.05, "crash": 0.5})).assign(
            task="u-turn", traffic=traffic
        )
        for traffic in ("regular", "risky")
    ]
    rows = pd.concat(rows, ignore_index=True).assign(level="3", within=3.0, actions="")
    rows = rows.reindex(columns=[*takeover.COLUMNS])
    takeover_file = tmp_path / "takeover" / "u-turn" / "moments.parquet"
    write_part(takeover_file, "moments", takeover.COLUMNS, rows, {})
    dense = rows.assign(level="12", moment=1.0)  # stands beside, and is not of the answers
    file = tmp_path / "takeover" / "u-turn-12" / "moments.parquet"
    write_part(file, "moments", takeover.COLUMNS, dense, {})
    page = Page(report.write_report(tmp_path).read_text())
    assert "Skill or caution?" in page.text and "treated agents" in page.text
    lines = skill_or_caution(rows)
    assert lines["traffic"].tolist() == ["regular", "risky"]
    assert lines["who is more careful"].tolist() == ["treated agents"] * 2
    careful = "get into danger less often in risky traffic on u-turn, in regular traffic on u-turn; elsewhere"
    assert careful in page.text and careful in report.answer(tmp_path)
    assert "agents crash neither less nor more often" in page.text
    text = (tmp_path / report.TEXT).read_text()
    signs = [line.split(" | ")[-2:] for line in text.splitlines() if line.startswith("| u-turn | r")]
    assert signs[:2] == [[MINUS, "too few |"]] * 2
    assert set(lines["who is more skilled"]) <= {"not decided", "depends on whose moments", "too few"}
    assert all(value in page.text for value in lines["caution [points]"])
    assert "Secondary, in denser traffic; unadjusted:" in page.text and "u-turn 12" in page.text
    takeover_file.write_bytes(takeover_file.read_bytes()[:-9])
    with pytest.raises(DamagedEpisodes):
        report.write_report(tmp_path)
