"""The reproduction card: what the paper says, what was done here, whether that is the same, and why not.

The paper is arXiv 2103.10245. What it says is quoted or counted here once; what was done here comes from the stored
cells, so that the card is right for any result directory.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from experiments.analysis.wording import BACKENDS, listing
from experiments.study.grid import BACKENDS as SIMULATORS
from experiments.study.presets import PAPER_EPISODES
from sumo_env.tasks import TASKS

SAME, PARTLY, DIFFERENT = "same", "in part", "different"
Row = dict[str, str]
SETTINGS = sum(len(task.levels) for task in TASKS.values())
FORMULA = "1/N [Σ R(T, risky) + Σ R(T, regular) − Σ R(C, risky) + Σ R(C, regular)]"


def card(analysis: Mapping[str, Any], cells: Mapping[str, Mapping[str, Any]]) -> list[Row]:
    """The rows of the card.

    Args:
        analysis: from `analysis.analyse`. cells: cell.json of the analysed cells by name.

    Returns:
        Rows with topic, paper, here, same ("same", "in part" or "different") and why.
    """
    agents = [cell["key"] for cell in cells.values() if cell["key"]["kind"] == "agent"]
    keys = [cell["key"] for cell in cells.values()]
    rows = [
        _simulator(keys),
        _settings(keys),
        _treatment(keys),
        *_learner(agents),
        _seeds(agents),
        _test(keys),
    ]
    return [*rows, *_measures(), *_results(analysis["claims"])]


def _row(topic: str, paper: str, here: str, same: str, why: str) -> Row:
    return {"topic": topic, "paper": paper, "here": here, "same": same, "why": why}


def _simulator(keys: Sequence[Mapping[str, Any]]) -> Row:
    used = [name for name in SIMULATORS if any(key["backend"] == name for key in keys)]
    words = {
        "sumo": "highway-env's tasks on SUMO, whose calibrated drivers drive the traffic",
        "replica": "highway-env's own physics, compiled",
        "highway-env": "highway-env itself, with scenarios of this study",
    }
    original = {"replica", "highway-env"}
    return _row(
        "Simulator",
        "highway-env, with changes that are not published",
        listing([words[name] for name in used]),
        DIFFERENT if not original & set(used) else PARTLY if set(used) - original else SAME,
        "An effect that is real should not hang on one simulator; validation says how close they are."
        if "sumo" in used
        else "The scenarios are drawn by this study, because the paper's are not published.",
    )


def _settings(keys: Sequence[Mapping[str, Any]]) -> Row:
    found = {(key["task"], key["level"]) for key in keys}
    return _row(
        "Tasks and traffic",
        f"highway 50 to 150 vehicles, two-way 5+2 to 15+6, roundabout 5 to 15, intersection 10 to 30, u-turn 3 to 12: "
        f"{SETTINGS} settings",
        f"{len(found)} of the same {SETTINGS} settings",
        SAME if len(found) == SETTINGS else PARTLY,
        "The numbers between the ends of roundabout and two-way are not printed; even steps are taken."
        + ("" if len(found) == SETTINGS else " The others were not run here."),
    )


def _treatment(keys: Sequence[Mapping[str, Any]]) -> Row:
    linear = any(key["env_config"].get("risk_law") == "linear" for key in keys)
    return _row(
        "Treatment",
        "acceleration and steering parameters of the other drivers drawn from p_min + rand[0,1] (p_max − p_min), their "
        "range changed “significantly”; no number is printed",
        "the same law on highway-env's LinearVehicle, with ranges made twice as wide"
        if linear
        else "the same law on the parameters of the drivers, with ranges in docs/traffic-and-risk.md, and seeded "
        "cut-ins, braking and surges where parameters do not reach",
        PARTLY,
        "The ranges had to be chosen: the dose is fitted so that a careful driver crashes 10 to 30 points more often."
        if not linear
        else "The ranges had to be chosen: twice is the widest that leaves all parameters positive.",
    )


def _values(agents: Sequence[Mapping[str, Any]], name: str) -> str:
    return listing(sorted({str(key["profile"][name]) for key in agents if name in key["profile"]})) or "none"


def _learner(agents: Sequence[Mapping[str, Any]]) -> list[Row]:
    network, gamma = _values(agents, "network"), _values(agents, "gamma")
    if not agents:
        return []
    updates = sorted({int(key["profile"]["updates"]) for key in agents})
    budget = f"{updates[0]}" if len(updates) == 1 else f"{updates[0]} to {updates[-1]}"
    same = network == "dueling" and gamma == "0.99"
    return [
        _row(
            "Learner",
            "DQN with a dueling network 256-192-128 and 2 × 128, Adam 5e-4, discount .99, batch 100; exploration, "
            "replay and target network are not printed",
            f"double DQN, network {network}, discount {gamma}, batch {_values(agents, 'batch_size')}, "
            f"{_values(agents, 'steps_per_update')} environment steps per update",
            PARTLY,
            "What is not printed is highway-env's companion code's, but for its target network, with "
            "which agents diverged."
            if same
            else "With the paper's settings agents do not learn every task here; the tuned learner does "
            "(docs/learner.md).",
        ),
        _row(
            "Budget",
            f"{PAPER_EPISODES} episodes for every agent",
            f"{budget} updates for every agent, the same in both arms",
            DIFFERENT,
            "Agents that crash have shorter episodes: equal episodes would train the two arms unequally.",
        ),
    ]


def _seeds(agents: Sequence[Mapping[str, Any]]) -> Row:
    numbers: dict[tuple[Any, ...], set[int]] = {}
    for key in agents:
        numbers.setdefault((key["backend"], key["task"], key["level"], key["arm"]), set()).add(key["seed"])
    counts = sorted({len(seeds) for seeds in numbers.values()})
    here = f"{counts[0]}" if len(counts) == 1 else f"{counts[0]} to {counts[-1]}" if counts else "no"
    return _row(
        "Repetition",
        "“different initiating random seeds”, their number is not printed; no interval, no test",
        f"{here} training seeds per arm and setting; every difference with a 95 % interval over training seeds and "
        "test scenarios",
        DIFFERENT,
        "What is randomised is the training. Agents that differ in nothing but the seed drive differently.",
    )


def _test(keys: Sequence[Mapping[str, Any]]) -> Row:
    tests = sorted({int(key["eval"]["episodes"]) for key in keys})
    return _row(
        "Test",
        "100 samples per agent in regular and in risky traffic",
        f"{listing([str(n) for n in tests])} regular and as many risky scenarios, the same for all agents, none of "
        "them met in training",
        SAME if tests == [100] else PARTLY,
        "The same scenarios for all: their luck cancels in the comparison.",
    )


def _measures() -> list[Row]:
    return [
        _row(
            "Formula of the effect",
            f"as printed: {FORMULA}; the last sign is an error: the control's reward in regular traffic is added",
            "(T − C) in risky traffic + (T − C) in regular traffic; what the printed formula gives is shown under "
            "“How it was computed”",
            DIFFERENT,
            "Read as printed, the effect is positive even where the arms do not differ. The paper's text describes "
            "what is computed here.",
        ),
        _row(
            "Outcome",
            "average reward; the effect in percent, of what is not printed",
            "return, also in percent of the control's; the primary outcome is the crash rate in risky traffic (on the "
            "two-way road the time to crash)",
            PARTLY,
            "Return is not safety: the two-way road's reward has no crash term, the roundabout's pays for the "
            "commanded speed.",
        ),
        _row(
            "Numbers",
            "plots only: the paper prints no table of numbers, so that sizes cannot be compared",
            "every number in analysis.json, summary.csv and effects.csv, with the cells that it rests on",
            DIFFERENT,
            "What can be compared is the direction of its statements: see the rows below.",
        ),
        _row(
            "Code and data",
            "none are public",
            "the commands of this report make everything again",
            DIFFERENT,
            "A result that nobody can run again is hard to trust or to correct.",
        ),
    ]


SAID = {
    "sum": "“positive ATE result values”: treated agents “always exceeded” control agents, on every task and level",
    "effect": "the improvement “further increases as the traffic continues to increase”, on every task",
    "mean": "“a declining trend of average reward as the traffic increases for every driving task”",
}


def _results(claims: Sequence[Mapping[str, Any]]) -> list[Row]:
    rows = []
    for claim in claims:
        if claim["source"] == "paper":
            name = BACKENDS.get(claim["backend"], claim["backend"])
            same = {"holds": SAME, "contradicted": DIFFERENT}.get(claim["verdict"], claim["verdict"])
            decides = f" What would decide it: {claim['decides']}." if claim["decides"] else ""
            here = f"on {name}: {claim['reason']}"
            rows.append(
                _row(f"Result: {claim['short']}", SAID[claim["quantity"]], here, same, decides.strip())
            )
    return rows
