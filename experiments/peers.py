"""highway-env, EnvPool's copy of it, the replica and SUMO side by side: speed, situations, crash rates.

`benchmark.py --parts peers` runs this file in one process for each of them, because EnvPool may be installed elsewhere
(ENVPOOL_PYTHON); therefore it imports nothing of ours but what the environment asked for needs.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

PEERS = ("highway-env", "envpool", "replica", "sumo")
ROOT = Path(__file__).resolve().parents[1]
# Meta-actions of the constant policies.
WITH_LANES = {"idle": 1, "faster": 3, "slower": 4}
WITHOUT_LANES = {"idle": 1, "faster": 2, "slower": 0}  # the intersection


class Episodes:
    """One environment of a peer with highway-env's default configuration, driven episode by episode."""

    def __init__(self, peer: str, task: str) -> None:
        self.peer, self.task = peer, task
        self._env = None if peer == "envpool" else self._made()
        self.start(0)
        self.actions = WITHOUT_LANES if task == "intersection" else WITH_LANES

    def _made(self) -> Any:
        import gymnasium as gym

        if self.peer == "highway-env":
            import highway_env  # noqa: F401

            return gym.make(f"{self.task}-v0")
        return gym.make(f"sumo_env:{self.peer}/{self.task}-v0")

    def start(self, seed: int) -> bytes:
        """Begin the episode of a seed; returns the first observation."""
        if self.peer == "envpool":
            import envpool
            import numpy as np

            self._action = np.zeros(1, np.int32)
            self._env = envpool.make_gymnasium(f"{self.task}-v0", num_envs=1, seed=seed)
            return bytes(self._env.reset()[0].tobytes())
        assert self._env is not None
        return bytes(self._env.reset(seed=seed)[0].tobytes())

    def step(self, action: int) -> tuple[bool, bool]:
        """Whether the episode is over, and whether the ego has crashed."""
        assert self._env is not None
        if self.peer == "envpool":
            self._action[0] = action
        _, _, terminated, truncated, info = self._env.step(self._action if self.peer == "envpool" else action)
        over, crashed = terminated or truncated, info["crashed"]
        return (bool(over[0]), bool(crashed[0])) if self.peer == "envpool" else (bool(over), bool(crashed))

    def distinct(self, seeds: int) -> int:
        """Different first observations."""
        return len({self.start(seed) for seed in range(seeds)})

    def crash_rate(self, policy: str, seeds: int) -> float:
        """Share of episodes of a constant policy that end in a crash."""
        crashes = 0
        for seed in range(seeds):
            self.start(seed)
            over = False
            while not over:
                over, crashed = self.step(self.actions[policy])
            crashes += crashed
        return crashes / seeds

    def rate(self, seconds: float, seed: int) -> float:
        """Policy steps per second of processor time under random actions, resets included."""
        import numpy as np

        rng, over, steps = np.random.default_rng(seed), True, 0
        actions = 3 if self.task == "intersection" else 5
        begun, cpu = time.perf_counter(), time.process_time()
        while steps < 3 or time.perf_counter() - begun < seconds:
            if over and self.peer != "envpool":  # EnvPool begins the next episode itself
                self.start(int(rng.integers(10_000)))
            over, _ = self.step(int(rng.integers(actions)))
            steps += 1
        return steps / (time.process_time() - cpu)


class Peer:
    """`Episodes` in a process of its own."""

    def __init__(self, peer: str, task: str, python: Path) -> None:
        environment = {**os.environ, "PYTHONPATH": str(ROOT), "PYTHONWARNINGS": "ignore"}
        self._process = subprocess.Popen(
            [str(python), __file__, peer, task], env=environment, text=True,
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
        )  # fmt: skip

    def ask(self, method: str, *arguments: Any) -> Any:
        """The result of a method; None if the process has ended, such as that of a peer that is not installed."""
        assert self._process.stdin is not None and self._process.stdout is not None
        try:
            self._process.stdin.write(json.dumps([method, *arguments]) + "\n")
            self._process.stdin.flush()
        except BrokenPipeError:
            return None
        answer = self._process.stdout.readline()
        return json.loads(answer) if answer else None

    def close(self) -> None:
        """End the process."""
        self._process.communicate()


def measure(
    task: str, python: Path, turns: int, seconds: float, seeds: int, episodes: int
) -> Iterator[dict[str, Any]]:
    """Rows of the benchmark's table: each peer beside highway-env, rates in turns.

    `distinct` is the number of different first observations of so many seeds, `crash_rates` are those of the constant
    policies over so many episodes. python: that has envpool; without it EnvPool is left out.
    """
    peers = {name: Peer(name, task, python if name == "envpool" else Path(sys.executable)) for name in PEERS}
    try:
        here = [name for name in PEERS if peers[name].ask("distinct", 1) is not None]
        if "envpool" not in here:
            print(f"EnvPool is left out: {python} has none (ENVPOOL_PYTHON names a Python)", file=sys.stderr)
        rates = [{name: peers[name].ask("rate", seconds, turn) for name in here} for turn in range(turns)]
        for name in here:
            ratios = sorted(turn[name] / turn["highway-env"] for turn in rates)
            crashes = {policy: peers[name].ask("crash_rate", policy, episodes) for policy in WITH_LANES}
            distinct = peers[name].ask("distinct", seeds)
            yield {
                "of": f"{name}, {task}",
                "steps_per_second": sorted(turn[name] for turn in rates)[turns // 2],
                "highway_env": sorted(turn["highway-env"] for turn in rates)[turns // 2],
                "ratio": ratios[turns // 2],
                "distinct": distinct,
                "crash_rates": crashes,
            }
    finally:
        for peer in peers.values():
            peer.close()


def _answer() -> None:
    """The loop of the process of a peer."""
    out = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # what libraries print is no answer
    episodes = Episodes(*sys.argv[1:])
    for line in sys.stdin:
        method, *arguments = json.loads(line)
        print(json.dumps(getattr(episodes, method)(*arguments)), file=out, flush=True)


if __name__ == "__main__":
    _answer()
