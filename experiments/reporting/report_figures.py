"""Which figures the report shows of a simulator, in which order, and what stands below them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from markupsafe import Markup

from experiments.analysis.effects import Record
from experiments.analysis.plan import OUTCOMES
from experiments.analysis.tables import CONFIRMATORY, TASK_ORDER
from experiments.reporting import collision_figures, figures
from experiments.study.results import Results


@dataclass(frozen=True)
class Shown:
    """A figure in the report: its title, the caption below it and the drawing."""

    title: str
    caption: str
    svg: Markup


def backend_figures(
    results: Results, own: Mapping[str, Sequence[Record]], cells: Mapping[str, Mapping[str, Any]]
) -> list[Shown]:
    """All figures that the data allow.

    Args:
        results: all stored cells.
        own: parts of the analysis by name, of one simulator. cells: cell.json of its cells, by name.
    """
    agents = {name: cell for name, cell in cells.items() if cell["key"]["kind"] == "agent"}
    shown = []
    for outcome in reversed(CONFIRMATORY):
        if any(r["outcome"] == outcome and r["estimate"] is not None for r in own["ate"]):
            side = (
                "Left of 0 is safer."
                if outcome == "crashed"
                else "Right of 0 is better. The paper's figure 7."
            )
            shown.append(
                Shown(
                    f"Treatment effect on the {OUTCOMES[outcome].label.lower()}",
                    "Treatment minus control for every task and traffic level, with 95 % intervals over training "
                    "seeds and test scenarios, not adjusted for their number. Hollow: some agents fail the gates. "
                    f"{side}",
                    _safe(figures.effects_by_place(own["ate"], outcome)),
                )
            )
    for task in TASK_ORDER:
        if records := [r for r in own["policies"] if r["task"] == task]:
            shown.append(
                Shown(
                    f"{task.capitalize()}: return and crash rate against traffic",
                    "Means over training seeds with 95 % intervals. Grey marks are policies that do not look, the "
                    "green star is the careful driver, the mark to beat. The paper's figure 6, with the crash rate "
                    "beside the return.",
                    _safe(figures.against_traffic(records, task)),
                )
            )
    for task in TASK_ORDER:
        own_task = {name: cell for name, cell in agents.items() if cell["key"]["task"] == task}
        if curves := {
            name: cell for name, cell in own_task.items() if "curve" in (cell.get("learner") or {})
        }:
            shown.append(
                Shown(
                    f"{task.capitalize()}: learning curves",
                    "Training episodes, with exploration, each arm in its own traffic: mean over seeds and one "
                    "standard deviation.",
                    _safe(figures.learning_curves(curves, task)),
                )
            )
    shown.append(
        Shown(
            "Near-misses",
            "Steps with a time-to-collision below 1.5 s and no crash, per test episode, with 95 % intervals over "
            "training seeds.",
            _safe(figures.near_misses(own["policies"])),
        )
    )
    if agents:
        shown += [
            Shown(
                "Collisions",
                "The trained agents' crashes in the tests, seen from the ego (black outline, heading right). Outlines "
                f"are other vehicles at the moment of contact, at most {collision_figures.MOST} a picture; dots are "
                "points of contact, larger where they are frequent. The paper's figure 3.",
                _safe(collision_figures.collisions(results.episodes[results.episodes["cell"].isin(agents)])),
            ),
            Shown(
                "Q-values during training",
                "Largest |Q| on the probe states, a line an agent. No policy can be worth more than the bound: an "
                "agent above it has diverged.",
                _safe(figures.probe_q(agents)),
            ),
        ]
    return shown


def _safe(svg: str) -> Markup:
    """Our own drawing, whose texts are escaped: the template shall not escape it again."""
    return Markup(svg)
