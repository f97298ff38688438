"""The report's figures: each a pure function of frames that returns an SVG text.

One meaning for each colour: blue is the control arm, pink mixed training, orange the treatment, green the careful
driver, grey every other policy without training, and ink what is a difference. Figures are deterministic (the same data
give the same bytes); their colours are CSS variables with a fallback, so that a page can show them in a light or a dark
scheme, and their ids carry the figure's name.
"""

import html
import io
import re
from collections.abc import Mapping
from typing import Any

import matplotlib.style
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator, PercentFormatter
from scipy import stats

from experiments.analysis.drivers import hazards
from experiments.analysis.plan import ALPHA
from experiments.reporting.tables import MINUS
from experiments.study.design.arms import ARMS, DOSE_ARMS, EVERY_ARM
from experiments.study.design.levels import tasks_known
from experiments.study.design.traffic import TRAFFICS

WIDTH = 7.2  # [inch]
INK, MUTED, GRID, PAPER = "#1f2328", "#6b7280", "#d9dde3", "#ffffff"
CONTROL, TREATMENT, CAREFUL = "#0072b2", "#d55e00", "#009e73"  # Okabe and Ito: told apart by all eyes
COLOURS = {"control": CONTROL, "mixed": "#cc79a7", "treatment": TREATMENT}  # by arm, in the order of the risk
VARIABLES = {INK: "ink", MUTED: "muted", GRID: "grid", PAPER: "paper"}
VARIABLES |= {CONTROL: "control", TREATMENT: "treatment", CAREFUL: "careful"}
# Where colours tell tasks apart instead, an arm is hollow (control) or filled (treatment).
TASKS = {
    "highway": "#3f6fae",
    "two-way": "#d0435e",
    "roundabout": "#228833",
    "intersection": "#8a3a8f",
    "u-turn": "#a87400",
    "two-way-brakes": "#00808c",
}
VARIABLES |= {colour: task for task, colour in TASKS.items()}
# The variables of a figure that stands alone, in a dark scheme.
DARK = {"ink": "#e6e9ed", "muted": "#98a2b0", "grid": "#343b45", "paper": "#14171b"}
DARK |= {"control": "#58b4e6", "treatment": "#f08a3c", "careful": "#2cc295"}
DARK |= dict(zip(TASKS, ("#7fb0f0", "#ff8095", "#5fcf7a", "#d58ae0", "#e8b440", "#4fc6d2"), strict=True))
STYLE: Any = {
    "font.family": "sans-serif", "font.sans-serif": ["DejaVu Sans"], "font.size": 8.5,
    "axes.titlesize": 9, "axes.titleweight": "bold", "axes.labelsize": 8.5,
    "xtick.labelsize": 8, "ytick.labelsize": 8, "legend.fontsize": 8, "legend.frameon": False,
    "text.color": INK, "axes.labelcolor": INK, "axes.titlecolor": INK,
    "xtick.color": MUTED, "ytick.color": MUTED, "xtick.labelcolor": INK, "ytick.labelcolor": INK,
    "axes.edgecolor": MUTED, "axes.linewidth": 0.7, "axes.spines.top": False, "axes.spines.right": False,
    "axes.grid": True, "axes.axisbelow": True, "grid.color": GRID, "grid.linewidth": 0.6,
    "xtick.major.size": 2.5, "ytick.major.size": 2.5, "lines.linewidth": 1.6, "lines.markersize": 5,
    "figure.facecolor": "none", "axes.facecolor": "none", "savefig.facecolor": "none",
    "svg.fonttype": "none", "svg.hashsalt": "report",
}  # fmt: skip
# Whatever the user's own settings are, a function of this module draws in the report's style.
styled = matplotlib.style.context(["default", STYLE])
# The same, so that it can be read on a telephone.
LARGER: Any = {"font.size": 11, "axes.titlesize": 12, "axes.labelsize": 11, "xtick.labelsize": 10}
LARGER |= {"ytick.labelsize": 10, "legend.fontsize": 10}
larger = matplotlib.style.context(["default", STYLE | LARGER])
# Of policies.
MARKS = {"idle": "o", "slower": "v", "faster": "^", "random": "D", "idm": "s", "planner": "P", "sumo": "X"}


def new_figure(rows: int, columns: int, height: float, **options: Any) -> tuple[Figure, np.ndarray]:
    """A figure of the report's width with an array (rows, columns) of axes; height in inches."""
    figure = Figure(figsize=(WIDTH, height), layout="constrained")
    return figure, figure.subplots(rows, columns, squeeze=False, **options)


def to_svg(figure: Figure, name: str, description: str) -> str:
    """The figure as an <svg> element to be inlined; `description` is read to people who do not see it."""
    buffer = io.StringIO()
    figure.savefig(buffer, format="svg", metadata=dict.fromkeys(("Date", "Creator", "Format", "Type")))
    text = buffer.getvalue()
    text = text[text.index("<svg") :].strip()
    text = re.sub(r'\bid="', f'id="{name}-', text)
    text = re.sub(r'(href="#|url\(#)', rf"\g<1>{name}-", text)
    for colour, variable in VARIABLES.items():
        text = re.sub(colour, f"var(--{variable}, {colour})", text, flags=re.IGNORECASE)
    label = html.escape(description, quote=True)
    return text.replace("<svg ", f'<svg role="img" aria-label="{label}" ', 1)


def alone(svg: str) -> str:
    """A figure as a file of its own: with a background and with the colours of a light and of a dark scheme."""
    light = {name: colour for colour, name in VARIABLES.items() if name in DARK}
    schemes = [":root {" + "".join(f"--{name}: {one[name]};" for name in DARK) + "}" for one in (light, DARK)]
    style = f"{schemes[0]} @media (prefers-color-scheme: dark) {{ {schemes[1]} }} svg {{ background: var(--paper) }}"
    return svg.replace(">", f"><style>{style}</style>", 1) + "\n"


def share_axis(axes: Axes) -> None:
    """A crash rate on the vertical axis."""
    axes.set_ylim(-0.04, 1.04)
    axes.yaxis.set_major_formatter(PercentFormatter(1.0, 0, " %"))


def mark_of(policy: str) -> dict[str, Any]:
    """How a policy without training is drawn: the careful driver as a green star, smaller at other cautions than 1, the
    others hollow and grey.
    """
    if policy.startswith("careful"):
        return {"marker": "*", "color": CAREFUL, "ms": 8 if policy == "careful" else 4}
    return {"marker": MARKS.get(policy, "d"), "color": MUTED, "ms": 4, "mfc": "none"}


def _arms(frame: pd.DataFrame) -> list[str]:
    """The arms that have a colour and are there; the two that are compared are always named."""
    return [arm for arm in COLOURS if arm in ARMS or (frame["arm"] == arm).any()]


def legend(holder: Figure | Axes, looks: Mapping[str, Mapping[str, Any]], **place: Any) -> None:
    """A legend of lines and marks, by their labels; above the figure where `place` says nothing else."""
    handles = [Line2D([], [], label=label, **look) for label, look in looks.items()]
    holder.legend(handles=handles, **{"loc": "outside upper center", **place})


def _legend(figure: Figure, arms: list[str], policies: list[str], **more: Any) -> None:
    looks: dict[str, Any] = {arm: {"color": COLOURS[arm], "marker": "o", **more} for arm in arms}
    looks |= {policy: {"ls": "", **mark_of(policy)} for policy in policies}
    legend(figure, looks, ncols=len(looks), columnspacing=1.0, handletextpad=0.3)


def by_task(frame: pd.DataFrame, rows: int, height: float, **options: Any) -> tuple[Figure, dict[str, Any]]:
    """A figure with a column for each task: by task its axes from top to bottom."""
    tasks = sorted(frame["task"].unique(), key=tasks_known().index)
    figure, axes = new_figure(rows, len(tasks), height, **options)
    columns = dict(zip(tasks, axes.T, strict=True))
    for task, column in columns.items():
        column[0].set_title(task)
    return figure, columns


def _panels(frame: pd.DataFrame) -> tuple[Figure, list[tuple[pd.DataFrame, Axes]]]:
    """A figure of crash rates with a column for each task and a row for each traffic: rows of each, and its axes."""
    figure, columns = by_task(frame, 2, 3.5, sharex="col", sharey=True)
    panels = []
    for row, traffic in enumerate(reversed(TRAFFICS)):
        next(iter(columns.values()))[row].set_ylabel(f"crash rate,\n{traffic} traffic")
        for task, column in columns.items():
            panels.append((frame[(frame["task"] == task) & (frame["traffic"] == traffic)], column[row]))
            share_axis(column[row])
    return figure, panels


@styled
def against_traffic(policies: pd.DataFrame, backend: str) -> str:
    """Crash rate against the traffic level: a column for each task, a row for each traffic of the test.

    policies: `analysis.policies` of one backend.
    """
    arms, there = _arms(policies), set(policies["policy"])
    shown = [name for name in ("careful", *MARKS) if name in there]  # in the order in which they are drawn
    bars: dict[str, Any] = {"marker": "o", "ms": 4, "capsize": 2, "lw": 1.5, "elinewidth": 1.0}
    figure, panels = _panels(policies.sort_values("level"))
    for tested, panel in panels:
        levels = tested.drop_duplicates("level")
        for arm, shift in zip(arms, np.linspace(-0.08, 0.08, len(arms)), strict=True):
            own = tested[tested["arm"] == arm]
            half = stats.t.ppf(1 - ALPHA / 2, own["n"] - 1) * own["crashed se"]
            half = half.fillna(0.0)  # with one agent
            panel.errorbar(own["level"] + shift, own["crashed"], half, color=COLOURS[arm], **bars)
        for number, policy in enumerate(shown):  # beside each other, so that none hides another
            own = tested[tested["policy"] == policy]
            panel.plot(own["level"] + 0.2 + 0.07 * number, own["crashed"], ls="", **mark_of(policy))
        panel.set_xlim(levels["level"].min() - 0.4, levels["level"].max() + 0.75)
        panel.set_xticks(levels["level"], levels["level_name"])
    figure.supxlabel("traffic level", fontsize=8.5)
    _legend(figure, arms, shown)
    return to_svg(figure, f"{backend}-traffic", "Crash rate against traffic level, by task and policy")


@styled
def effects_by_setting(effects: pd.DataFrame, backend: str) -> str:
    """The effect on the crash rate in every setting, with intervals at the level at which the plan decides.

    Filled: decided (Holm); hollow: open. effects: of treatment against control, one backend.
    """
    rows = effects[effects["outcome"] == "crashed"]
    places = rows.drop_duplicates(["task", "level"])[["task", "level", "level_name"]]
    gap = {task: 0.6 * number for number, task in enumerate(places["task"].unique())}
    heights = {(p.task, p.level): -(k + gap[p.task]) for k, p in enumerate(places.itertuples())}
    figure, axes = new_figure(1, 2, 1.0 + 0.22 * len(places), sharex=True, sharey=True)
    for panel, term in zip(axes[0], ("risky", "regular"), strict=True):
        panel.axvline(0, color=INK, lw=0.8)
        panel.set_title(f"tested in {term} traffic")
        for row in rows[rows["term"] == term].itertuples():
            y, decided = heights[row.task, row.level], row.p_adjusted < ALPHA
            if not np.isnan(row.low_family):
                panel.plot([row.low_family, row.high_family], [y, y], color=INK, lw=1.4)
            panel.plot(row.estimate, y, "o", color=INK, mfc=INK if decided else PAPER, ms=5)
        panel.grid(axis="y", visible=False)
        panel.xaxis.set_major_formatter(lambda value, _: f"{100 * value:.0f}".replace("-", MINUS))
        panel.set_xlabel(f"treatment {MINUS} control [points], left is safer")
    axes[0, 0].set_yticks(list(heights.values()), [f"{p.task} {p.level_name}" for p in places.itertuples()])
    full = {"color": INK, "marker": "o"}
    looks = {"decided, all settings together": full, "open": {**full, "mfc": PAPER}}
    legend(figure, looks, loc="outside upper right", ncols=2)
    return to_svg(figure, f"{backend}-effects", "Effect on the crash rate by setting and traffic")


@styled
def dose_response(policies: pd.DataFrame, backend: str) -> str:
    """Crash rate against the dose of risk in training, by task and traffic of the test, where there are doses."""
    doses = policies[policies["arm"].isin(DOSE_ARMS) & policies["traffic"].isin(list(TRAFFICS))]
    between = doses[~doses["arm"].isin(list(ARMS))][["task", "level"]].drop_duplicates()
    of_arm = {name: arm.traffic.dose for name, arm in EVERY_ARM.items()}
    doses = doses.merge(between).assign(dose=lambda frame: frame["arm"].map(of_arm))
    styles = {"risky": "-", "regular": "--"}
    figure, columns = by_task(doses, 1, 2.1, sharey=True)
    for task, [panel] in columns.items():
        for traffic, style in styles.items():
            own = doses[(doses["task"] == task) & (doses["traffic"] == traffic)]
            mean = own.groupby("dose")["crashed"].mean()
            panel.plot(mean.index, mean, style, color=INK, marker="o", ms=4)
        share_axis(panel)
        panel.set_xticks([0, 0.5, 1], ["0", ".5", "1"])
    figure.axes[0].set_ylabel("crash rate")
    figure.supxlabel("dose of risk in training", fontsize=8.5)
    legend(figure, {f"{name} traffic": {"color": INK, "ls": ls} for name, ls in styles.items()}, ncols=2)
    return to_svg(figure, f"{backend}-doses", "Crash rate against the dose of risk in training, by task")


@styled
def learning_curves(cells: Mapping[str, Mapping[str, Any]], backend: str) -> str:
    """Return and crash rate of the training episodes against environment steps, at the lightest level of each task.

    cells: cell.json of trained agents on one backend, by name.
    """
    curves = pd.DataFrame([{**cell["key"], "curve": cell["learner"]["curve"]} for cell in cells.values()])
    curves = curves[curves["level"] == curves.groupby("task")["level"].transform("min")]
    figure, columns = by_task(curves, 2, 3.2, sharex="col", sharey="row")
    for task, column in columns.items():
        for panel, outcome in zip(column, ("return", "crashed"), strict=True):
            for arm, colour in COLOURS.items():
                own = curves.loc[(curves["task"] == task) & (curves["arm"] == arm), "curve"]
                if own.empty:
                    continue
                values = pd.DataFrame([curve[outcome] for curve in own], dtype=float)
                ends = np.array([curve["step"] for curve in own], dtype=float).mean(axis=0)
                x, mean, spread = (ends - ends[0] / 2) / 1000, values.mean(), values.std(ddof=1).fillna(0)
                panel.plot(x, mean, color=colour)
                panel.fill_between(x, mean - spread, mean + spread, color=colour, alpha=0.2, lw=0)
        share_axis(column[1])
    for panel, name in zip(next(iter(columns.values())), ("return", "crash rate"), strict=True):
        panel.set_ylabel(name)
    figure.supxlabel("environment steps (thousands)", fontsize=8.5)
    _legend(figure, _arms(curves), [], ls="-")
    return to_svg(figure, f"{backend}-learning", "Return and crash rate of training episodes, by arm")


@styled
def crashes_by_second(episodes: pd.DataFrame, backend: str) -> str:
    """Of the drives still on the road, the share that crashes in each second, at the lightest level of each task.

    episodes: of trained agents on one backend, as from `scores.with_outcomes`.
    """
    episodes = episodes[episodes["level"] == episodes.groupby("task")["level"].transform("min")]
    arms = _arms(episodes)
    figure, panels = _panels(episodes)
    top = 0.0
    for driven, panel in panels:
        for arm in arms:
            own = driven[driven["arm"] == arm]
            if own.empty:
                continue
            rates = hazards(own)
            mean, half = rates.mean(), rates.sem() * stats.t.ppf(1 - ALPHA / 2, max(len(rates) - 1, 1))
            low, high = (mean - half).clip(lower=0), (mean + half).clip(upper=1)
            panel.plot(mean.index, mean, color=COLOURS[arm], marker="o", ms=2.5, lw=1.2)
            panel.fill_between(mean.index, low, high, color=COLOURS[arm], alpha=0.2, lw=0)
            top = max(top, 1.2 * mean.max())
        panel.xaxis.set_major_locator(MaxNLocator(4, integer=True))
    for _, panel in panels:
        panel.set_ylim(-0.04 * top, top)
    figure.supxlabel("second of the test", fontsize=8.5)
    _legend(figure, arms, [], ls="-")
    return to_svg(figure, f"{backend}-seconds", "Crashes by second of the test, by task and arm")
