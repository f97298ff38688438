"""benchmark.html: one file with its pictures inside, made from the content of benchmark.json alone."""

from __future__ import annotations

import io
import re
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import jinja2
import matplotlib

matplotlib.use("svg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from experiments.benchmarks.targets import number

Results = Mapping[str, Any]
Record = Mapping[str, Any]

TEMPLATE = "benchmark.html"
# Okabe and Ito's colours, which remain apart for colour-blind readers.
COLOURS = {
    "matched": "#0072B2", "sumo": "#E69F00", "highway_env": "#777777", "own": "#0072B2", "sb3": "#D55E00",
    "floor": "#009E73", "engine": "#009E73",
}  # fmt: skip
STYLE: Any = {"font.size": 9, "axes.spines.top": False, "axes.spines.right": False, "svg.fonttype": "none"}


def render(results: Results) -> str:
    """The page as HTML."""
    pictures: dict[str, str] = {}
    with plt.rc_context(STYLE):
        if results.get("env"):
            pictures["ratios"] = _svg(_ratios(results["env"]))
            pictures["shares"] = _svg(_shares(results["env"]))
        if results.get("growth"):
            pictures["growth"] = _svg(_growth(results["growth"]))
        if results.get("learner"):
            pictures["learner"] = _svg(_learner(results["learner"]))
        if results.get("vector"):
            pictures["vector"] = _svg(_vector(results["vector"]))
        if results.get("memory"):
            pictures["memory"] = _svg(_memory(results["memory"]))
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).resolve().parents[1] / "templates"),
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True,
    )  # fmt: skip
    environment.filters["number"] = number
    return environment.get_template(TEMPLATE).render(results=results, pictures=pictures)


def _svg(figure: Figure) -> str:
    """A figure as an SVG element that stands in a page beside others."""
    buffer = io.StringIO()
    figure.savefig(buffer, format="svg", bbox_inches="tight", metadata={"Date": None})
    plt.close(figure)
    text = buffer.getvalue()
    text = text[text.index("<svg") :]
    # matplotlib's ids are unique within a figure only
    prefix = f"f{zlib.crc32(text.encode())}-"
    text = re.sub(r'id="', f'id="{prefix}', text)
    text = re.sub(r'href="#', f'href="#{prefix}', text)
    return re.sub(r"url\(#", f"url(#{prefix}", text)


def _bars(
    axes: Axes, labels: Sequence[str], series: Mapping[str, Sequence[float]], form: str = "{:.0f}"
) -> None:
    """Groups of vertical bars with their values above."""
    width = 0.8 / len(series)
    for k, (name, values) in enumerate(series.items()):
        places = np.arange(len(labels)) + (k - (len(series) - 1) / 2) * width
        colour = COLOURS.get(name.split(",")[0], "#333333")
        bars = axes.bar(
            places, values, width, label=name, color=colour, alpha=0.55 if "15 Hz" in name else 1.0
        )
        axes.bar_label(bars, [form.format(value) for value in values], fontsize=7, padding=1)
    axes.set_xticks(np.arange(len(labels)), labels, fontsize=8)


def _places(records: Sequence[Record]) -> list[tuple[str, str]]:
    return list(dict.fromkeys((record["task"], record["level"]) for record in records))


def _ratios(records: Sequence[Record]) -> Figure:
    """Times highway-env, by task and level: equal work and default frequency, both traffic models."""
    figure, axes = plt.subplots(figsize=(11, 3.6))
    places = _places(records)
    series: dict[str, list[float]] = {}
    for record in records:
        work = "15 Hz" if record["equal_work"] else f"{record['simulation_frequency']} Hz"
        values = series.setdefault(f"{record['traffic_model']}, {work}", [np.nan] * len(places))
        values[places.index((record["task"], record["level"]))] = record["ratio"]
    _bars(axes, [f"{task}\n{level}" for task, level in places], series)
    axes.set_yscale("log")
    axes.set_ylabel("times as many policy steps\na second as highway-env")
    axes.legend(ncols=4, frameon=False, loc="upper center", bbox_to_anchor=(0.5, 1.17))
    return figure


def _shares(records: Sequence[Record]) -> Figure:
    """Share of the loop that SUMO's own step takes, at the default frequency."""
    figure, axes = plt.subplots(figsize=(11, 2.6))
    places = _places(records)
    series: dict[str, list[float]] = {}
    for record in records:
        if not record["equal_work"]:
            values = series.setdefault(record["traffic_model"], [np.nan] * len(places))
            values[places.index((record["task"], record["level"]))] = 100.0 * record["engine_share"]
    _bars(axes, [f"{task}\n{level}" for task, level in places], series)
    axes.set_ylim(0, 100)
    axes.set_ylabel("SUMO's own step,\n% of the time")
    axes.legend(ncols=2, frameon=False, loc="upper right")
    return figure


def _growth(growth: Record) -> Figure:
    """Time of a policy step over the number of vehicles, both axes logarithmic."""
    figure, axes = plt.subplots(figsize=(5.2, 3.6))
    for name, values in growth["ms_per_step"].items():
        label = f"{name.replace('_', '-')}: exponent {growth['exponent'][name]:.2f}"
        axes.loglog(
            growth["vehicles"][: len(values)], values, "o-", label=label, color=COLOURS[name], markersize=4
        )
    axes.set_xticks(growth["vehicles"], [str(count) for count in growth["vehicles"]])
    axes.minorticks_off()
    axes.set_xlabel("other vehicles on the highway")
    axes.set_ylabel("ms a policy step")
    axes.legend(frameon=False)
    return figure


def _learner(records: Sequence[Record]) -> Figure:
    """Milliseconds an update, by network and shape of the observations."""
    figure, axes = plt.subplots(figsize=(7.5, 3.0))
    names = [f"{record['network']}\n{record['observation'][0]} vehicles" for record in records]
    series = {
        label: [1e3 / record[key] for record in records]
        for label, key in (("this project", "updates_per_s"), ("Stable-Baselines3", "sb3_updates_per_s"))
    }
    _bars(axes, names, series)
    axes.set_ylabel("ms an update")
    axes.legend(frameon=False)
    return figure


def _vector(records: Sequence[Record]) -> Figure:
    """Steps a second of a vector over its workers."""
    figure, axes = plt.subplots(figsize=(5.2, 3.0))
    for task in dict.fromkeys(record["task"] for record in records):
        own = [record for record in records if record["task"] == task]
        axes.plot(
            [r["workers"] for r in own], [r["steps_per_s"] for r in own], "o-", label=task, markersize=4
        )
    axes.set_xticks(sorted({record["workers"] for record in records}))
    axes.set_ylim(bottom=0)
    axes.set_xlabel("environments (one process each)")
    axes.set_ylabel("steps a second together (wall time)")
    axes.legend(frameon=False)
    return figure


def _memory(memory: Record) -> Figure:
    """Resident memory over the episodes."""
    figure, axes = plt.subplots(figsize=(5.2, 2.6))
    axes.plot(memory["episodes"], memory["rss_mib"], color=COLOURS["own"])
    axes.set_ylim(0, 1.2 * max(memory["rss_mib"]))
    axes.set_xlabel(f"episodes of {memory['task']}")
    axes.set_ylabel("resident memory [MiB]")
    return figure
