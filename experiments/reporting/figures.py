"""The report's figures: each a pure function of tables and records that returns an SVG text.

How they look is in `style`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator, NullFormatter
from scipy import stats

from agents.training import Q_SLACK
from experiments.analysis.plan import ALPHA, OUTCOMES
from experiments.analysis.tables import TASK_ORDER
from experiments.reporting.style import (
    CAREFUL,
    COLOURS,
    CONTROL,
    INK,
    MINUS,
    MUTED,
    PAPER,
    TREATMENT,
    VIOLET,
    new_figure,
    styled,
    to_svg,
)
from experiments.study.arms import ARMS, TRAFFICS

SIDES: list[dict[str, Any]] = [
    {"color": colour, "marker": marker}
    for colour, marker in (
        (VIOLET, "o"),
        (INK, "s"),
        (CONTROL, "D"),
        (TREATMENT, "^"),
        (CAREFUL, "v"),
        (MUTED, "P"),
    )
]  # of directories side by side
MARKS = {"careful": "*", "idle": "o", "random": "D", "faster": "^", "slower": "v", "idm": "s"}


def _percent(axes: Axes, outcome: str) -> None:
    """Write the ticks of a share as percentages."""
    if OUTCOMES[outcome].percent:
        axes.yaxis.set_major_formatter(lambda value, _: f"{100 * value:.0f} %")


def _half_width(record: Mapping[str, Any], outcome: str) -> float:
    """Half of the 95 % interval of a policy's mean over its units; 0 where there is only one unit."""
    se = record["se"][outcome]
    return float(stats.t.ppf(1 - ALPHA / 2, record["n"] - 1)) * se if se is not None else 0.0


def _mark(policy: str) -> dict[str, Any]:
    """How a baseline is drawn: the careful driver as a green star, the others as hollow grey marks."""
    if policy == "careful":
        return {"marker": MARKS[policy], "color": CAREFUL, "ms": 9}
    return {"marker": MARKS[policy], "color": MUTED, "ms": 4.5, "mfc": "none"}


@styled
def learning_curves(cells: Mapping[str, Mapping[str, Any]], task: str) -> str:
    """Return and crash rate of the training episodes against environment steps, a column per traffic level.

    cells: cell.json of the trained agents of one backend and task, by name.
    """
    curves = [(cell["key"], cell["learner"]["curve"]) for cell in cells.values()]
    levels = dict(sorted({key["level"]: key["level_name"] for key, _ in curves}.items()))
    figure, axes = new_figure(2, len(levels), 3.6, sharex=True, sharey="row")
    for column, (level, level_name) in enumerate(levels.items()):
        axes[0, column].set_title(f"{task} {level_name}")
        for row, outcome in enumerate(("return", "crashed")):
            for arm, colour in COLOURS.items():
                own = [curve for key, curve in curves if (key["level"], key["arm"]) == (level, arm)]
                if not own:
                    continue
                values = pd.DataFrame([curve[outcome] for curve in own], dtype=float)
                ends = np.array([curve["step"] for curve in own], dtype=float).mean(axis=0)
                x = (ends - ends[0] / 2) / 1000
                mean, spread = values.mean(), values.std(ddof=1).fillna(0)
                axes[row, column].plot(x, mean, color=colour)
                band = (mean - spread, mean + spread)
                if OUTCOMES[outcome].percent:
                    band = (band[0].clip(0, 1), band[1].clip(0, 1))
                axes[row, column].fill_between(x, *band, color=colour, alpha=0.2, lw=0)
            _percent(axes[row, column], outcome)
        axes[1, column].set_ylim(-0.05, 1.05)
    axes[0, 0].set_ylabel("Return")
    axes[1, 0].set_ylabel("Crash rate")
    figure.supxlabel("Environment steps (thousands)", fontsize=8.5)
    handles = [Line2D([], [], color=colour, label=arm) for arm, colour in COLOURS.items()]
    figure.legend(handles=handles, loc="outside upper right", ncols=2)
    return to_svg(
        figure,
        f"{curves[0][0]['backend']}-learning-{task}",
        f"Learning curves of {task}: return and crash rate of training episodes by arm",
    )


@styled
def against_traffic(records: Sequence[Mapping[str, Any]], task: str) -> str:
    """Return and crash rate against the traffic level in both test traffics (the paper's figure 6).

    records: `analysis.policies` of one backend and task.
    """
    levels = dict(sorted({r["level"]: r["level_name"] for r in records}.items()))
    figure, axes = new_figure(2, 2, 4.6 if len(levels) > 1 else 3.4, sharex=True, sharey="row")
    for column, traffic in enumerate(TRAFFICS):
        axes[0, column].set_title(f"tested in {traffic} traffic")
        for row, outcome in enumerate(("return", "crashed")):
            for arm, shift in (("control", -0.08), ("treatment", 0.08)):
                chosen = [r for r in records if (r["arm"], r["traffic"]) == (arm, traffic)]
                axes[row, column].errorbar(
                    [r["level"] + shift for r in chosen],
                    [r["mean"][outcome] for r in chosen],
                    [_half_width(r, outcome) for r in chosen],
                    color=COLOURS[arm], marker="o", capsize=2.5, lw=1.6, elinewidth=1.1,
                )  # fmt: skip
            for number, policy in enumerate(MARKS):  # side by side, so that none hides another
                chosen = [r for r in records if (r["policy"], r["traffic"]) == (policy, traffic)]
                x, y = (
                    [r["level"] + 0.2 + 0.06 * number for r in chosen],
                    [r["mean"][outcome] for r in chosen],
                )
                axes[row, column].plot(x, y, ls="", **_mark(policy))
            _percent(axes[row, column], outcome)
        axes[1, column].set_ylim(-0.05, 1.05)
        axes[1, column].set_xticks(list(levels), list(levels.values()))
        axes[1, column].set_xlim(min(levels) - 0.5, max(levels) + 0.6)
        axes[1, column].set_xlabel(f"Traffic level of {task}")
    axes[0, 0].set_ylabel("Return per episode")
    axes[1, 0].set_ylabel("Crash rate")
    handles = [Line2D([], [], color=COLOURS[arm], marker="o", label=arm) for arm in ARMS]
    handles += [Line2D([], [], ls="", label=policy, **_mark(policy)) for policy in MARKS]
    figure.legend(
        handles=handles, loc="outside upper center", ncols=len(handles), columnspacing=1.2, handletextpad=0.4
    )
    return to_svg(
        figure,
        f"{records[0]['backend']}-traffic-{task}",
        f"Return and crash rate of all policies on {task} against traffic",
    )


def _place_rows(records: Sequence[Mapping[str, Any]]) -> dict[tuple[str, int], float]:
    """A height for each task and level, from top to bottom, with a gap between tasks."""
    places = sorted({(TASK_ORDER[r["task"]], r["task"], r["level"]) for r in records})
    gap = {task: 0.6 * k for k, task in enumerate(dict.fromkeys(task for _, task, _ in places))}
    return {(task, level): -(k + gap[task]) for k, (_, task, level) in enumerate(places)}


def _name_rows(
    axes: Axes, rows: Mapping[tuple[str, int], float], records: Sequence[Mapping[str, Any]]
) -> None:
    names = {(r["task"], r["level"]): f"{r['task']} {r['level_name']}" for r in records}
    axes.set_yticks(list(rows.values()), [names[place] for place in rows])
    axes.set_ylim(min(rows.values()) - 0.7, 0.7)


@styled
def effects_by_place(records: Sequence[Mapping[str, Any]], outcome: str) -> str:
    """Treatment effects with their intervals for every task and level (the paper's figure 7).

    Hollow where agents fail the gates. records: of `effects.effects`, one backend.
    """
    records = [r for r in records if r["outcome"] == outcome]
    rows = _place_rows(records)
    figure, axes = new_figure(1, 3, 1.1 + 0.24 * len(rows), sharex=True, sharey=True)
    for panel, term in zip(axes[0], ("sum", "risky", "regular"), strict=True):
        panel.axvline(0, color=INK, lw=0.8)
        panel.set_title({"sum": "both (the paper's ATE)"}.get(term, f"tested in {term} traffic"))
        for r in records:
            if r["term"] != term or r["estimate"] is None:
                continue
            y = rows[r["task"], r["level"]]
            hollow = any(r["failed"])
            colour = MUTED if hollow else INK
            if r["low"] is not None:
                panel.plot([r["low"], r["high"]], [y, y], color=colour, lw=1.1 if hollow else 1.8, alpha=0.9)
            mark = "o" if r["low"] is not None else "D"
            panel.plot(r["estimate"], y, mark, color=colour, mfc=PAPER if hollow else colour, ms=5)
        panel.grid(axis="y", visible=False)
        panel.xaxis.set_major_locator(MaxNLocator(4))
        unit = ""
        if OUTCOMES[outcome].percent:
            panel.xaxis.set_major_formatter(lambda value, _: f"{100 * value:.0f}".replace("-", MINUS))
            unit = " [points]"
        panel.set_xlabel(f"treatment {MINUS} control{unit}")
    _name_rows(axes[0, 0], rows, records)
    handles = [
        Line2D([], [], color=INK, marker="o", label="95 % interval"),
        Line2D([], [], color=MUTED, marker="o", mfc=PAPER, lw=1.1, label="some agents fail the gates"),
        Line2D([], [], color=INK, marker="D", ls="", label="no interval"),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=3)
    label = OUTCOMES[outcome].label
    return to_svg(
        figure,
        f"{records[0]['backend']}-ate-{outcome}",
        f"{label}: treatment effects by task and traffic level",
    )


@styled
def side_by_side(
    sides: Sequence[Mapping[tuple[str, int] | None, Mapping[str, Any]]], names: Sequence[str], name: str
) -> str:
    """Effects on the crash rate in risky traffic of several directories, setting by setting, and their means.

    sides: for each the records of its settings by task and level, and that of the mean under None.
    """
    settings = [r for side in sides for key, r in side.items() if key is not None]
    rows: dict[tuple[str, int] | None, float] = dict(_place_rows(settings).items())
    labels: dict[tuple[str, int] | None, str] = {
        (r["task"], r["level"]): f"{r['task']} {r['level_name']}" for r in settings
    }
    if any(None in side for side in sides):
        rows[None], labels[None] = 1.4, "mean, tasks alike"
    styles = [SIDES[number % len(SIDES)] for number in range(len(sides))]
    height = 0.2 + 0.1 * len(sides)
    figure, axes = new_figure(1, 1, 0.9 + 0.18 * len(sides) + height * (len(rows) + 1))
    panel = axes[0, 0]
    panel.axvline(0, color=INK, lw=0.8)
    for number, (side, style) in enumerate(zip(sides, styles, strict=True)):
        for key, r in side.items():
            y = rows[key] + 0.7 * ((len(sides) - 1) / 2 - number) / len(sides)
            hollow = r["low"] is None
            if not hollow:
                panel.plot(
                    [r["low"], r["high"]], [y, y], color=style["color"], lw=2.4 if key is None else 1.4
                )
            mark = {**style, "mfc": PAPER if hollow else style["color"], "ms": 7 if key is None else 4.5}
            panel.plot(r["estimate"], y, ls="", **mark)
    panel.set_yticks(list(rows.values()), [labels[key] for key in rows])
    panel.set_ylim(min(rows.values()) - 0.7, max(rows.values()) + 0.6)
    panel.xaxis.set_major_formatter(lambda value, _: f"{100 * value:.0f}".replace("-", MINUS))
    panel.set_xlabel(f"Crash rate in risky traffic, treatment {MINUS} control [points]; left of 0 is safer")
    panel.grid(axis="y", visible=False)
    handles = [Line2D([], [], label=label, **style) for label, style in zip(names, styles, strict=True)]
    figure.legend(handles=handles, loc="outside upper left", ncols=1)
    return to_svg(
        figure, name, f"Effects on the crash rate in risky traffic, side by side: {', '.join(names)}"
    )


@styled
def near_misses(records: Sequence[Mapping[str, Any]]) -> str:
    """Near-misses per test episode of both arms and the careful driver.

    records: `analysis.policies`, one backend.
    """
    rows = _place_rows(records)
    figure, axes = new_figure(1, 2, 1.1 + 0.24 * len(rows), sharey=True, sharex=True)
    for panel, traffic in zip(axes[0], TRAFFICS, strict=True):
        for r in records:
            if r["traffic"] != traffic or not (r["arm"] or r["policy"] == "careful"):
                continue
            y = rows[r["task"], r["level"]] + {"control": 0.16, "treatment": -0.16, None: 0.0}[r["arm"]]
            colour = COLOURS.get(r["arm"], CAREFUL)
            value, half = r["mean"]["near_misses"], _half_width(r, "near_misses") if r["arm"] else 0.0
            panel.plot([value - half, value + half], [y, y], color=colour, lw=1.4)
            mark, size = ("o", 4.5) if r["arm"] else ("*", 8)
            panel.plot(value, y, mark, color=colour, ms=size, clip_on=False, zorder=3)
        panel.set_title(f"tested in {traffic} traffic")
        panel.set_xlabel("Steps with a near-miss per episode")
        panel.grid(axis="y", visible=False)
    axes[0, 0].set_xlim(left=0)
    _name_rows(axes[0, 0], rows, records)
    handles = [Line2D([], [], color=colour, marker="o", label=arm) for arm, colour in COLOURS.items()]
    handles.append(Line2D([], [], color=CAREFUL, marker="*", ms=8, ls="", label="careful driver"))
    figure.legend(handles=handles, loc="outside lower center", ncols=3)
    return to_svg(
        figure,
        f"{records[0]['backend']}-near-misses",
        "Near-misses per episode by task, traffic level and arm",
    )


@styled
def probe_q(cells: Mapping[str, Mapping[str, Any]]) -> str:
    """Largest absolute Q-value on the probe states during training, a line an agent, with the gate's bound.

    cells: cell.json of the trained agents of one backend, by name.
    """
    backend = next(cell["key"]["backend"] for cell in cells.values())
    tasks = sorted({cell["key"]["task"] for cell in cells.values()}, key=TASK_ORDER.__getitem__)
    columns = min(3, len(tasks))
    figure, axes = new_figure(-(-len(tasks) // columns), columns, 0.6 + 1.8 * -(-len(tasks) // columns))
    for spare in axes.flat[len(tasks) :]:
        spare.set_visible(False)
    for panel, task in zip(axes.flat, tasks, strict=False):
        bounds: list[float] = []
        panel.set_title(task)
        panel.set_yscale("log")
        panel.yaxis.set_minor_formatter(NullFormatter())
        for cell in cells.values():
            curve = (cell.get("learner") or {}).get("probe_q")
            if cell["key"]["task"] != task or not curve:
                continue
            updates, _, largest = np.array(curve, dtype=float).T
            colour = COLOURS[cell["key"]["arm"]]
            mark = "o" if len(updates) == 1 else None
            panel.plot(
                updates / 1000, np.maximum(largest, 1e-3), color=colour, lw=0.9, alpha=0.7, marker=mark
            )
            if cell["learner"].get("q_bound"):
                bounds.append(Q_SLACK * cell["learner"]["q_bound"])
        for bound in sorted(set(bounds)):
            panel.axhline(bound, color=INK, lw=1.0, ls=(0, (4, 2)))
            panel.set_ylim(bottom=min(bound / 100, panel.get_ylim()[0]))
    figure.supxlabel("Updates (thousands)", fontsize=8.5)
    figure.supylabel("Largest |Q| on the probe states", fontsize=8.5)
    handles = [Line2D([], [], color=colour, label=arm) for arm, colour in COLOURS.items()]
    handles.append(Line2D([], [], color=INK, lw=1.0, ls=(0, (4, 2)), label="bound of the gate"))
    figure.legend(handles=handles, loc="outside upper right", ncols=3)
    return to_svg(
        figure, f"{backend}-probe-q", "Largest Q-values on the probe states against updates, by task"
    )
