"""The architecture: who may import whom, and what an import costs."""

import ast
from collections.abc import Iterator
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

from sumo_env.tasks import TASKS
from tests.processes import ROOT, python

MAY_IMPORT = {
    "networks": set(),
    "sumo_env": {"networks"},
    "agents": set(),
    "experiments": {"networks", "sumo_env", "agents"},
}
STUDY = {"torch", "matplotlib", "pandas", "scipy", "pyarrow", "statsmodels", "rich", "tyro", "jinja2"}
STUDY |= {"stable_baselines3", "highway_env"}
COMPILERS = {"numba", "llvmlite", "ctypes", "cffi"}


def name_of(path: Path) -> str:
    """The module in a file. The roads are found by their link, sumo_env.networks."""
    parts = list(path.relative_to(ROOT).with_suffix("").parts)
    if parts[0] == "networks":
        parts.insert(0, "sumo_env")
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


FILES = {name_of(path): path for package in MAY_IMPORT for path in (ROOT / package).rglob("*.py")}


def imported(path: Path) -> Iterator[str]:
    """Full names of all that a file imports, wherever in it; ``from package import module`` means the module."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}:{node.lineno}: relative import"
            inner = {f"{node.module}.{alias.name}" for alias in node.names}
            yield from inner & FILES.keys() or {node.module or ""}


IMPORTS = [(name, used) for name, path in FILES.items() for used in imported(path)]
WITHIN = [(name, used) for name, used in IMPORTS if used in FILES and used != "sumo_env"]


def top(module: str) -> str:
    return module.partition(".")[0]


def room(module: str) -> str:
    """The top-level folder that holds a module."""
    return "networks" if module.startswith("sumo_env.networks") else top(module)


def test_imports_point_one_way() -> None:
    """experiments -> agents, sumo_env -> networks."""
    ways = [(name, used) for name, used in IMPORTS if room(used) in MAY_IMPORT and room(used) != room(name)]
    assert ways and [way for way in ways if room(way[1]) not in MAY_IMPORT[room(way[0])]] == []


# The parts of two packages, the lowest first: a part uses those below it alone. What is not listed is above them all.
# Of what any SUMO scenario needs these cannot stand with `scenarios`: `traffic.scenario.SumoTraffic` and `Origin`, of
# which a `Scenario` is made for every simulator; `traffic.sumo_schemas`, which `Driver.like` asks in every task;
# `sumo.user_options` and `settings.file_settings`, of which `env.sumo_access` makes SUMO and `sumo_command`.
FLOORS = {
    "sumo_env": """
        networks < scene streams unsupported < config < contacts < traffic < tasks simulator < rendering sumo < spaces
        < compat < env < scenarios < __main__ parallel
    """,
    "experiments": """
        support < backends < study < analysis < reporting < validation
        < report rare < sweep
    """,
    "experiments.study": "design < results < compute < replaying",
}


@pytest.mark.parametrize("package", FLOORS)
def test_packages_are_built_on_floors(package: str) -> None:
    floors, place = [set(parts.split()) for parts in FLOORS[package].split("<")], package.count(".") + 1
    floor_of = {name.split(".")[place]: len(floors) for name in FILES if name.startswith(f"{package}.")}
    assert set().union(*floors) <= floor_of.keys()
    floor_of |= {part: number for number, parts in enumerate(floors) for part in parts}
    wrong = [
        f"{name} imports {used}, which is not below it"
        for name, used in WITHIN
        if name.startswith(f"{package}.") and used.startswith(f"{package}.")
        for here, there in [(name.split(".")[place], used.split(".")[place])]
        if here != there and floor_of[there] >= floor_of[here]
    ]
    assert wrong == []


def test_no_folder_holds_a_circle() -> None:
    """Of the files and folders beside each other in any folder, none uses one that uses it, over however many."""
    folders: dict[str, dict[str, set[str]]] = {}
    for name, used in WITHIN:
        ours, theirs = (f"{name}.__init__".split("."), f"{used}.__init__".split("."))
        depth = next((k for k, (a, b) in enumerate(zip(ours, theirs, strict=False)) if a != b), None)
        if depth:  # where the two ways part, below their package
            uses = folders.setdefault(".".join(ours[:depth]), {})
            uses.setdefault(ours[depth], set()).add(theirs[depth])
    assert sum(len(used) for uses in folders.values() for used in uses.values()) > 100  # something was found
    for uses in folders.values():
        TopologicalSorter(uses).prepare()  # raises CycleError, which names the circle


@pytest.mark.parametrize("package", ["sumo_env.sumo", "agents"])
def test_neither_the_simulator_nor_an_agent_names_a_task(package: str) -> None:
    """What they have to know of a task travels in the scenario, or is a property of the road or the space."""
    tasks = set(TASKS)
    assert [way for way in WITHIN if way[0].startswith(f"{package}.") and "sumo_env.tasks" in way[1]] == []
    for path in (path for name, path in FILES.items() if name.startswith(f"{package}.")):
        constants = [node for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.Constant)]
        assert not [node.lineno for node in constants if node.value in tasks], path


def test_the_environments_on_sumo_compile_nothing() -> None:
    """SUMO drives; what is left is fast enough in numpy and plain floats. The replica alone is compiled."""
    compiled = [name for name, used in IMPORTS if top(used) in COMPILERS and top(name) == "sumo_env"]
    assert {name.split(".")[1] for name in compiled} == {"replica"}


def test_one_module_imports_libsumo() -> None:
    assert {name for name, used in IMPORTS if top(used) in ("libsumo", "traci")} == {"sumo_env.sumo.engine"}


def test_the_environments_use_nothing_of_the_study() -> None:
    assert [way for way in IMPORTS if top(way[0]) == "sumo_env" and top(way[1]) in STUDY] == []


USE = """
import gymnasium as gym, sumo_env
for id in sumo_env.IDS:
    env = gym.make(id, config={"risk": 1.0})
    env.reset(seed=0)
    env.step(1)
    env.close()
"""


@pytest.mark.parametrize(
    ("statement", "unwanted"),
    [
        ("import sumo_env", STUDY | {"libsumo", "sumolib", "numba", "PIL"}),
        ("import sumo_env.vector", {"libsumo"}),
        ("import sumo_env.sumo.worker", {"torch", "pandas", "matplotlib", "PIL", "libsumo"}),
        (USE, {"torch", "matplotlib", "pandas", "statsmodels", "highway_env", "numba", "PIL"}),
        # each of its measuring processes imports it
        ("import experiments.benchmark", {"torch", "matplotlib", "stable_baselines3"}),
        # --help and errors of the command line wait for it
        (
            "from experiments import sweep, report, train, evaluate, rare, takeover, watch, replay, validate",
            {"torch", "stable_baselines3", "numba", "highway_env"},
        ),
    ],
)
def test_what_is_slow_is_loaded_where_it_is_used(statement: str, unwanted: set[str]) -> None:
    code = f"import sys\n{statement}\nprint(*{{name.split('.')[0] for name in sys.modules}})"
    assert unwanted.isdisjoint(python("-c", code).split())
