"""The learning curve of an agent: in the terminal while it is trained, and as a picture afterwards."""

from __future__ import annotations

from pathlib import Path
from statistics import fmean
from typing import Any

import gymnasium as gym

from experiments.study.grid import Cell
from experiments.study.store import TRAINING, Store

LINES = 20  # of a whole training in the terminal
BLOCKS = "▁▂▃▄▅▆▇█"
SMOOTH = 50  # training episodes over which the picture averages


class Live:
    """Prints how an agent learns: a line for each twentieth of the work, with the episodes since the last one."""

    def __init__(self, cell: Cell) -> None:
        self._training = cell.updates / (
            cell.updates + 10.0 * cell.work
        )  # share of the work that is training
        self._episodes: list[tuple[float, bool]] = []
        self._returns: list[float] = []
        self._next, self._tests = 1, False
        print(f"training {cell.slug}: {cell.updates} updates (stop and go on at any time)")

    def note(self, total: float, crashed: bool) -> None:
        """A training episode has ended."""
        self._episodes.append((total, crashed))

    def beat(self, done: float) -> None:
        """So much of the work is done, from 0 to 1; training comes first."""
        share = done / self._training
        if share >= self._next / LINES and self._next <= LINES and self._episodes:
            self._print(min(share, 1.0))
            self._next = int(share * LINES) + 1
        if share > 1.0 and not self._tests:
            self._tests = True
            print("testing it in regular and in risky traffic", flush=True)

    def _print(self, share: float) -> None:
        returns, crashes = zip(*self._episodes, strict=True)
        self._returns.append(fmean(returns))
        low, high = min(self._returns), max(self._returns)
        bars = "".join(BLOCKS[round(7 * (r - low) / ((high - low) or 1.0))] for r in self._returns)
        count = f"{len(returns)} episodes"
        print(
            f"{share:4.0%}  {count:>14}  return {fmean(returns):6.2f}  crashes {fmean(crashes):4.0%}  {bars}",
            flush=True,
        )
        self._episodes = []


class Watched(gym.Wrapper[Any, Any, Any, Any]):
    """Tells a `Live` of every episode."""

    def __init__(self, env: gym.Env[Any, Any], live: Live) -> None:
        super().__init__(env)
        self._live, self._total = live, 0.0

    def reset(self, **options: Any) -> tuple[Any, dict[str, Any]]:
        """Begin an episode."""
        self._total = 0.0
        return self.env.reset(**options)

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Drive one step."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        self._total += float(reward)
        if terminated or truncated:
            self._live.note(self._total, bool(info["crashed"]))
        return observation, reward, terminated, truncated, info


def draw(directory: Path, cell: Cell) -> Path:
    """Draw the return and the crashes of a stored agent's training episodes; returns the file."""
    import matplotlib

    matplotlib.use("agg")
    from matplotlib import pyplot as plt

    episodes = Store(directory).tables(cell.name)[TRAINING]
    smooth = episodes[["return", "crashed"]].astype(float).rolling(SMOOTH, min_periods=1).mean()
    figure, panels = plt.subplots(1, 2, figsize=(9, 3.2), layout="constrained")
    for panel, column, label in zip(
        panels, smooth, ("return", "share of episodes with a crash"), strict=True
    ):
        panel.plot(episodes["step"], smooth[column], color="#0072b2", lw=1.2)
        panel.set(xlabel="environment steps", ylabel=label)
        panel.grid(alpha=0.3)
    figure.suptitle(f"{cell.slug}: training episodes with exploration, mean of {SMOOTH}", fontsize=10)
    file = directory / f"{cell.slug}.png"
    figure.savefig(file, dpi=110)
    plt.close(figure)
    return file
