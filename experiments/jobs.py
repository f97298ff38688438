"""What a worker process is given at a time: a cohort of agents that train in lockstep, or some baselines."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence, Set
from dataclasses import dataclass

from experiments.files import canonical_json, sha256_bytes
from experiments.grid import Cell

LARGEST_COHORT = 10
JOBS_PER_WORKER = 4  # enough pieces that no worker idles long at the end


@dataclass(frozen=True)
class Job:
    """Cells of one task and level that one process computes one after the other or in lockstep.

    cells: of one kind and profile. cost: expected seconds. attempts: how often it was begun in this sweep.
    """

    cells: tuple[Cell, ...]
    cost: float
    attempts: int = 0

    @property
    def simulator(self) -> tuple[str, str]:
        """Backend and task: a process serves one of these only."""
        return self.cells[0].backend, self.cells[0].task

    @property
    def label(self) -> str:
        """A few words for the progress line."""
        first = self.cells[0]
        count = f" ({len(self.cells)} {'agents' if first.kind == 'agent' else 'baselines'})"
        return f"{first.task} {first.level_name}" + (count if len(self.cells) > 1 else f" {first.policy}")


def cohort_name(cells: Iterable[Cell]) -> str:
    """Name of the directory for the checkpoints of these agents in lockstep."""
    return "cohort-" + sha256_bytes(canonical_json(sorted(cell.name for cell in cells)).encode())[:12]


def plan(
    cells: Sequence[Cell],
    finished: Set[str],
    workers: int,
    seconds: Callable[[Cell], float],
    begun: Iterable[Sequence[str]] = (),
) -> list[Job]:
    """Deal unfinished cells out into jobs, the longest first.

    How agents are grouped changes the time that they take and nothing else. Agents that have a common
    checkpoint stay together, because it can only be resumed as a whole.

    Args:
        cells: what is wanted.
        finished: names of those that are stored already.
        workers: how many processes there will be.
        seconds: expected time of a cell.
        begun: names of the cells of each cohort with a checkpoint.
    """
    wanted = {cell.name: cell for cell in cells}
    by_name = {name: cell for name, cell in wanted.items() if name not in finished}
    groups: list[list[Cell]] = []
    for names in begun:
        # A sweep that was stopped between two tests leaves cohorts of which some agents are stored.
        if all(name in wanted for name in names) and any(name in by_name for name in names):
            groups.append([wanted[name] for name in names])
            for name in names:
                by_name.pop(name, None)
    agents = [cell for cell in by_name.values() if cell.kind == "agent"]
    size = min(max(len(agents) // (workers * JOBS_PER_WORKER), 2), LARGEST_COHORT)
    for members in _grouped(agents).values():
        count = -(-len(members) // size)  # as even as possible
        groups += [members[number::count] for number in range(count)]
    groups += _grouped([cell for cell in by_name.values() if cell.kind != "agent"]).values()
    jobs = [Job(tuple(group), sum(map(seconds, group))) for group in groups]
    return sorted(jobs, key=lambda job: -job.cost)


def _grouped(cells: Iterable[Cell]) -> dict[str, list[Cell]]:
    """Cells that can share a process: same task, level, kind and profile."""
    groups: dict[str, list[Cell]] = {}
    for cell in cells:
        alike = canonical_json([cell.backend, cell.task, cell.level, cell.kind, dict(cell.profile)])
        groups.setdefault(alike, []).append(cell)
    return groups
