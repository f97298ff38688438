"""Who gets into danger, and who gets out of it: the table and the figure of `experiments/takeover.py`."""

from collections.abc import Mapping
from itertools import product
from pathlib import Path

import pandas as pd
from matplotlib.ticker import PercentFormatter

from experiments.analysis.scores import in_order
from experiments.analysis.takeover import ADJECTIVES, CAUTION, SKILL, claims, each, of_tasks, overall
from experiments.reporting.arrows import TREATED, arrows
from experiments.reporting.figures import COLOURS, INK, PAPER, larger, legend, new_figure, styled, to_svg
from experiments.reporting.tables import MINUS, chosen, p_value, plain
from experiments.study.compute.takeover import BOUNDS, COLUMNS, PAIR, WINDOW
from experiments.study.design.arms import ARMS
from experiments.study.design.levels import level_names
from experiments.study.design.traffic import TRAFFICS
from experiments.study.results.parquet import read_part

RECORDS = "takeover/*/moments.parquet"  # of experiments/takeover.py, in a study's folder
ARM_OF = dict(zip(PAIR, ARMS, strict=True))
SIDES = dict(zip(TREATED, ("more", "less"), strict=True))  # of dangers and crashes, by who has fewer
SHOWN = [CAUTION, SKILL, *(f"{SKILL}, {leader} leads" for leader in PAIR)]


def recorded(directory: Path, lightest: bool = True) -> pd.DataFrame | None:
    """The records of a study's pairs by the bound of the plan, in each task's lightest traffic; None without one.

    lightest: or in the denser ones, whose settings then stand for the tasks.

    Raises:
        DamagedEpisodes: of a record that is damaged.
    """
    if not (files := sorted(directory.glob(RECORDS))):
        return None
    found = [read_part(path, "moments", COLUMNS, {}) for path in files]
    rows = chosen(pd.concat(found, ignore_index=True), within=BOUNDS[0])
    rows = rows[(rows["level"] == rows["task"].map(lambda task: level_names(task)[0])) == lightest]
    if not lightest:
        rows = rows.assign(task=rows["task"] + " " + rows["level"])
    return rows if len(rows) else None


@larger
def danger_figure(rows: pd.DataFrame) -> str:
    """Crashes from critical moments against episodes in danger, an arrow from control to treated agents for each task.

    rows: a record of several tasks, whose a and b are control and treated agents.
    """
    drivers = each(rows, ["task", "traffic"], overall).replace({"driver": ARM_OF})
    figure, panels = arrows(drivers, 4.3, "danger", 1.1)
    for panel in panels:
        panel.set_xticks([0, 0.5, 1])
        panel.xaxis.set_major_formatter(PercentFormatter(1.0, 0, " %"))
    panels[0].set_ylabel("critical moments that end in a crash")
    figure.supxlabel("episodes in danger", fontsize=11)
    words = (
        "Crashes from critical moments against episodes in danger, from control to treated agents, by task"
    )
    return to_svg(figure, "danger", words)


def skill_or_caution(rows: pd.DataFrame, decides: str = "p_holm") -> pd.DataFrame:
    """A row a task and traffic: both differences in points with their intervals, and what the plan decides.

    decides: "p" for an exploratory table, unadjusted.
    """
    found = of_tasks(rows)
    lines = []
    for (task, traffic), own in in_order(found, "task", "traffic").groupby(["task", "traffic"], sort=False):
        said, line = claims(own, TREATED, decides), {"task": task, "traffic": traffic}
        shown = table(own, dict(zip(PAIR, TREATED, strict=True))).set_index("question")
        for question in (CAUTION, SKILL):
            if question in shown.index:
                row = shown.loc[question]
                line[f"{question} [points]"] = f"{row['difference']} of {row['of']}"
                line[f"who is more {ADJECTIVES[question]}"] = said[question].partition(" is more ")[0]
        lines.append(line)
    return pd.DataFrame(lines)


def decided(lines: pd.DataFrame) -> dict[str, dict[str, dict[str, list[str]]]]:
    """What `skill_or_caution` decides of treated agents: tasks, by question ("careful", "skilled"), side and traffic.

    A side is "less" or "more" of what they are judged by: dangers, or crashes from equal moments. None is empty.
    """
    found: dict[str, dict[str, dict[str, list[str]]]] = {}
    for adjective, traffic in product(ADJECTIVES.values(), reversed(TRAFFICS)):
        sides = found.setdefault(adjective, {})
        for who, side in SIDES.items():
            own = lines[(lines["traffic"] == traffic) & (lines[f"who is more {adjective}"] == who)]
            if len(own):
                sides.setdefault(side, {})[traffic] = own["task"].tolist()
    return found


def question_in_words(question: str, names: Mapping[str, str]) -> str:
    """A question of `analysis.takeover.answers` with the drivers' names. names: of "a" and "b"."""
    head, comma, tail = question.partition(", ")
    leader, _, leads = tail.partition(" ")
    return f"{head}{comma}{names.get(leader, leader)}{f' {leads}' if leads else ''}"


def table(answers: pd.DataFrame, names: Mapping[str, str]) -> pd.DataFrame:
    """The answers as people read them: shares in per cent, differences in points with their 95 % intervals."""
    rows = []
    for row in answers.to_dict("records"):
        scale, digits = (1.0, 2) if row["question"].endswith("per km") else (100.0, 1)
        low, high = (plain(scale * row[end], digits, signed=True) for end in ("low", "high"))
        difference = plain(scale * row["estimate"], digits, signed=True)
        rows.append(
            {
                "question": question_in_words(row["question"], names),
                **{names[of]: plain(scale * row[of], digits) for of in PAIR},
                "difference": difference if row["low"] != row["low"] else f"{difference} [{low}, {high}]",
                "p": p_value(row["p"]) if row["status"] == "ok" else row["status"],
                "of": row["count"],
            }
        )
    return pd.DataFrame(rows)


def from_moments(rates: pd.DataFrame, names: Mapping[str, str]) -> pd.DataFrame:
    """Who crashes how often from whose moments, in per cent.

    rates: of `analysis.takeover.rates`. names: of "a" and "b".
    """
    shown = pd.DataFrame({"driver": rates["driver"].replace(names)})
    for name, title in (("crashed", f"within {WINDOW:g} s"), ("to_the_end", "to the end")):
        shown[title] = [plain(100 * value, 1) for value in rates[name]]
    shown.insert(0, "moments of", rates["leader"].map(names))
    return shown.assign(moments=rates["moments"])


@styled
def takeover_figure(answers: pd.DataFrame, rates: pd.DataFrame, names: Mapping[str, str], title: str) -> str:
    """Differences with their intervals on the left; on the right who crashes from whose moments; a row a traffic.

    answers, rates: of `analysis.takeover`, with a column traffic.
    """
    traffics = list(dict.fromkeys(answers["traffic"]))
    figure, axes = new_figure(len(traffics), 2, 0.7 + 1.5 * len(traffics), sharex="col")
    drivers = list(dict.fromkeys(rates["driver"])) if len(rates) else []
    for (left, right), traffic in zip(axes, traffics, strict=True):
        own = answers[(answers["traffic"] == traffic) & answers["question"].isin(SHOWN)]
        left.axvline(0, color=INK, lw=0.8)
        for number, row in enumerate(own.itertuples()):
            ends = [max(100 * row.low, -100), min(100 * row.high, 100)]
            left.plot(ends, [-number, -number], color=INK, lw=1.4)
            left.plot(100 * row.estimate, -number, "o", color=INK, mfc=INK if row.status == "ok" else PAPER)
        left.set_yticks(
            [-y for y in range(len(own))], [question_in_words(name, names) for name in own["question"]]
        )
        left.set_title(f"{traffic} traffic")
        for row in rates[rates["traffic"] == traffic].itertuples() if len(rates) else ():
            y = -drivers.index(row.driver) + (0.12 if row.leader == PAIR[0] else -0.12)
            colour = COLOURS[ARM_OF[row.leader]]
            right.plot([100 * row.low, 100 * row.high], [y, y], color=colour, lw=1.2)
            right.plot(100 * row.crashed, y, "o", color=colour)
        right.set_yticks([-y for y in range(len(drivers))], [names.get(name, name) for name in drivers])
        for panel in (left, right):
            panel.grid(axis="y", visible=False)
    axes[-1][0].set_xlabel(f"{names['b']} {MINUS} {names['a']} [points]")
    axes[-1][1].set_xlabel("crashes from the moments [%]")
    looks = {f"moments of {names[one]}": {"color": COLOURS[ARM_OF[one]], "marker": "o"} for one in PAIR}
    looks["nothing claimed"] = {"mec": INK, "mfc": PAPER, "marker": "o", "ls": ""}
    legend(figure, looks, loc="outside upper right", ncols=3, title=title)
    return to_svg(figure, "takeover", f"Who gets into danger, and who gets out of it: {title}")
