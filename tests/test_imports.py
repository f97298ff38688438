"""The architecture: who may import whom, and what an import costs."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

from tests.processes import ROOT, python

PACKAGES = ("networks", "sumo_env", "agents", "experiments")
MAY_IMPORT = {
    "networks": set(),
    "sumo_env": {"networks"},
    "agents": set(),
    "experiments": {"networks", "sumo_env", "agents"},
}
HEAVY = (
    "torch",
    "matplotlib",
    "pandas",
    "scipy",
    "pyarrow",
    "statsmodels",
    "stable_baselines3",
    "highway_env",
)


def sources(package: str) -> list[Path]:
    return sorted((ROOT / package).rglob("*.py"))


def imports(path: Path) -> Iterator[tuple[int, str]]:
    """Line and full name of all that a file imports, wherever in the file."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield node.lineno, alias.name
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}:{node.lineno}: relative import"
            yield node.lineno, node.module or ""


def room(module: str) -> str:
    """The top-level folder that holds a module; sumo_env.networks is a link to networks."""
    return "networks" if module.startswith("sumo_env.networks") else module.split(".")[0]


@pytest.mark.parametrize("package", PACKAGES)
def test_imports_point_one_way(package: str) -> None:
    """experiments -> agents, sumo_env -> networks."""
    allowed = MAY_IMPORT[package] | {package}
    wrong = [
        f"{path.relative_to(ROOT)}:{line} imports {name}"
        for path in sources(package)
        for line, name in imports(path)
        if room(name) in PACKAGES and room(name) not in allowed
    ]
    assert wrong == []


def modules(*packages: str) -> dict[str, Path]:
    """Name -> file. The roads are found by their link."""
    names = {}
    for path in (path for package in packages for path in sources(package)):
        parts = list(path.relative_to(ROOT).with_suffix("").parts)
        if parts[0] == "networks":
            parts.insert(0, "sumo_env")
        names[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return names


def used_modules(path: Path, known: dict[str, Path]) -> set[str]:
    """Known modules that a file imports, wherever; ``from package import module`` means the module."""
    used: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            used |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            inner = {f"{node.module}.{alias.name}" for alias in node.names}
            used |= inner & known.keys() or {node.module or ""}
    return used & known.keys() - {"sumo_env"}


# The parts of two packages, the lowest first: a part uses those below it alone. What is not listed is above them all.
FLOORS = {
    "sumo_env": """
        networks < scene streams config < contacts < traffic < tasks < actions simulator
        < observation information rendering views export < interface < sumo < env
    """,
    "experiments": """
        support < backends < study < analysis < reporting < validation
        < timed report < sweep
    """,
}


@pytest.mark.parametrize("package", FLOORS)
def test_packages_are_built_on_floors(package: str) -> None:
    floors = [set(parts.split()) for parts in FLOORS[package].split("<")]
    known = {name: path for name, path in modules(*PACKAGES).items() if name.startswith(f"{package}.")}
    floor_of = {name.split(".")[1]: len(floors) for name in known}
    assert set().union(*floors) <= floor_of.keys()
    floor_of |= {part: number for number, parts in enumerate(floors) for part in parts}
    wrong = [
        f"{name} imports {used}, which is not below it"
        for name, path in known.items()
        for used in sorted(used_modules(path, known))
        for here, there in [(name.split(".")[1], used.split(".")[1])]
        if here != there and floor_of[there] >= floor_of[here]
    ]
    assert wrong == []


def test_the_simulator_names_no_task() -> None:
    """What it has to know of a task travels in the scenario, or is a property of the road."""
    names = ("highway", "two-way", "roundabout", "intersection", "u-turn", "network")
    for path in sources("sumo_env/sumo"):
        assert not [name for _, name in imports(path) if name.startswith("sumo_env.tasks")], path
        constants = [node for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.Constant)]
        assert not [node.lineno for node in constants if node.value in names], path


def test_no_folder_holds_a_circle() -> None:
    """Of the files and folders beside each other in any folder, none uses one that uses it, over however many."""
    known = modules(*PACKAGES)
    folders: dict[str, dict[str, set[str]]] = {}
    for name, path in known.items():
        for used in used_modules(path, known):
            ours, theirs = (f"{name}.__init__".split("."), f"{used}.__init__".split("."))
            depth = next((k for k, (a, b) in enumerate(zip(ours, theirs, strict=False)) if a != b), None)
            if depth:  # where the two ways part, below their package
                uses = folders.setdefault(".".join(ours[:depth]), {})
                uses.setdefault(ours[depth], set()).add(theirs[depth])
    assert sum(len(used) for uses in folders.values() for used in uses.values()) > 100  # something was found
    for uses in folders.values():
        TopologicalSorter(uses).prepare()  # raises CycleError, which names the circle


COMPILERS = ("numba", "llvmlite", "ctypes", "cffi")


def test_the_environments_on_sumo_compile_nothing() -> None:
    """SUMO drives; what is left is fast enough in numpy and plain floats. The replica alone is compiled."""
    compiled = {
        name.split(".")[1]
        for name, path in modules("sumo_env", "networks").items()
        for _, imported in imports(path)
        if imported.split(".")[0] in COMPILERS
    }
    assert compiled == {"replica"}


def test_one_module_imports_libsumo() -> None:
    importers = {
        str(path.relative_to(ROOT))
        for package in PACKAGES
        for path in sources(package)
        for _, name in imports(path)
        if name.split(".")[0] in ("libsumo", "traci")
    }
    assert importers == {"sumo_env/sumo/session.py"}


def test_the_environments_use_nothing_of_the_study() -> None:
    wrong = [
        f"{path.relative_to(ROOT)}:{line} imports {name}"
        for package in ("networks", "sumo_env")
        for path in sources(package)
        for line, name in imports(path)
        if name.split(".")[0] in (*HEAVY, "rich", "tyro", "jinja2")
    ]
    assert wrong == []


def test_agents_name_no_task() -> None:
    tasks = {"highway", "two-way", "roundabout", "intersection", "u-turn"}
    named = [
        f"{path.relative_to(ROOT)}:{node.lineno} {node.value!r}"
        for path in sources("agents")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Constant) and node.value in tasks
    ]
    assert named == []


def loaded_by(statement: str) -> set[str]:
    """Top-level modules in a fresh interpreter after a statement."""
    code = f"import sys\n{statement}\nprint(*{{name.split('.')[0] for name in sys.modules}})"
    return set(python("-c", code).split())


def test_importing_the_environments_is_light() -> None:
    assert loaded_by("import sumo_env").isdisjoint({*HEAVY, "libsumo", "sumolib", "numba", "PIL"})


def test_using_an_environment_loads_nothing_of_the_study() -> None:
    use = """
import gymnasium as gym, sumo_env
for id in sumo_env.IDS:
    env = gym.make(id, config={"risk": 1.0})
    env.reset(seed=0)
    env.step(1)
    env.close()
"""
    loaded = loaded_by(use)
    assert "libsumo" in loaded
    assert loaded.isdisjoint({"torch", "matplotlib", "pandas", "statsmodels", "highway_env", "numba", "PIL"})


def test_steering_vector_environments_loads_no_sumo() -> None:
    assert "libsumo" not in loaded_by("import sumo_env.vector")


def test_the_benchmark_loads_what_is_slow_only_where_it_is_used() -> None:
    """Each of its measuring processes imports it."""
    assert loaded_by("import experiments.benchmark").isdisjoint({"torch", "matplotlib", "stable_baselines3"})
