"""What `benchmark.py` times: environments and learners, each in a process of its own that runs this file.

That may be a process of another Python, in which EnvPool is installed (ENVPOOL_PYTHON); therefore nothing of ours is
imported but what is asked for.
"""

from __future__ import annotations

import json
import os
import statistics
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
LEAST = 3  # steps in a slice
BATCH = 64  # environments
STORED = 10_000  # random transitions in every replay
# Meta-actions of the constant policies.
WITH_LANES = {"idle": 1, "faster": 3, "slower": 4}
WITHOUT_LANES = {"idle": 1, "faster": 2, "slower": 0}  # the intersection


class Process:
    """An object of this file in a process of its own, which prints its errors.

    Args:
        kind: name of its class.
        arguments: of the class, as plain values.
        python: that runs it.
    """

    def __init__(self, kind: str, *arguments: Any, python: str = sys.executable) -> None:
        environment = {**os.environ, "PYTHONPATH": str(ROOT), "PYTHONWARNINGS": "ignore"}
        command = [python, __file__, kind, json.dumps(arguments)]
        pipes: dict[str, Any] = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
        self._process = subprocess.Popen(command, env=environment, **pipes)

    def ask(self, method: str, *arguments: Any) -> Any:
        """The result of a method. Raises EOFError: the process has ended, by an error in it."""
        assert self._process.stdin is not None and self._process.stdout is not None
        with suppress(BrokenPipeError):
            print(json.dumps([method, *arguments]), file=self._process.stdin, flush=True)
        if answer := self._process.stdout.readline():
            return json.loads(answer)
        raise EOFError(f"{method} of {self._process.args!r} failed")

    def close(self) -> None:
        """End the process."""
        self._process.communicate()


def _answer(kind: str, arguments: str) -> None:
    """The loop of such a process."""
    out = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # what libraries print is no answer
    held = globals()[kind](*json.loads(arguments))
    for line in sys.stdin:
        method, *given = json.loads(line)
        print(json.dumps(getattr(held, method)(*given)), file=out, flush=True)


class EnvPool:
    """EnvPool's copy of a task as an environment of gymnasium. It begins the next episode by itself."""

    def __init__(self, task: str) -> None:
        import envpool
        import numpy as np

        self._action = np.zeros(1, np.int32)
        self._open = lambda seed: envpool.make_gymnasium(f"{task}-v0", num_envs=1, seed=seed)

    def reset(self, seed: int | None = None) -> tuple[Any, Any]:
        """Begin the episode of a seed, in a new environment; without a seed there is nothing to do."""
        if seed is None:
            return None, {}
        self._env = self._open(seed)
        return self._env.reset()

    def step(self, action: int) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Drive one step."""
        self._action[0] = action
        observation, reward, terminated, truncated, info = self._env.step(self._action)
        return observation, reward, bool(terminated[0]), bool(truncated[0]), {"crashed": info["crashed"][0]}


class Driver:
    """Drives an environment with random actions, as an exploring agent does: resets count in full.

    Args:
        backend: of the study, or "envpool".
        config: of the study's environment; None for the default configuration of the backend's own.
    """

    def __init__(self, backend: str, task: str, config: dict[str, Any] | None = None) -> None:
        import gymnasium as gym
        import numpy as np

        if backend == "envpool":
            self._env: Any = EnvPool(task)
        elif config is not None:
            from experiments.backends import make_env

            self._env = make_env(backend, task, config)
        elif backend == "highway-env":
            self._env = gym.make(f"highway_env:{task}-v0")
        else:
            self._env = gym.make(f"sumo_env:{backend}/{task}-v0")
        self._constant = WITHOUT_LANES if task == "intersection" else WITH_LANES
        self._rng, self._actions = np.random.default_rng(0), 3 if task == "intersection" else 5
        self._done, self._steps = False, 0
        # a slice ends with an episode and so holds its share of resets; highway-env's episodes take too long
        self._whole = backend != "highway-env"
        self._resets: list[float] = []  # processor time of each [s]
        self._env.reset(seed=0)
        self.rate(0.0)  # loads the network, compiles, fills caches
        self._steps, self._resets = 0, []

    def _reset(self) -> None:
        start = time.process_time()
        self._env.reset()
        self._resets.append(time.process_time() - start)

    def rate(self, seconds: float) -> float:
        """Policy steps per second of processor time, in a slice of so many seconds."""
        begun, cpu, steps = time.perf_counter(), time.process_time(), 0
        while steps < LEAST or time.perf_counter() - begun < seconds or (self._whole and not self._done):
            if self._done:
                self._reset()
            _, _, terminated, truncated, _ = self._env.step(int(self._rng.integers(self._actions)))
            self._done = terminated or truncated
            steps += 1
        self._steps += steps
        return steps / (time.process_time() - cpu)

    def bare_engine(self, seconds: float) -> float:
        """SUMO's own steps with the same vehicles on the road and nobody who reads or commands, as policy steps.

        It takes as many steps of SUMO as the mean episode so far did, a warm-up included.
        """
        from sumo_env.sumo.session import libsumo  # the only importer of it

        env, usual = self._env.unwrapped, len(self._resets)
        episode = max(round(self._steps / usual), 1)
        frequency = env.config["simulation_frequency"]
        begun, cpu, count = time.perf_counter(), 0.0, 0
        while not count or time.perf_counter() - begun < seconds:
            self._reset()
            steps = round(env.scenario.warm_up * frequency)
            steps += episode * frequency // env.config["policy_frequency"]
            start = time.process_time()
            for _ in range(steps):
                libsumo.simulationStep()
            cpu, count = cpu + time.process_time() - start, count + episode
        self._reset()
        self._done = False
        del self._resets[usual:]  # SUMO's clock has been moved, so that these have loaded the network anew
        return count / cpu

    def reset_ms(self) -> float:
        """Median processor time of the resets so far [ms]."""
        return 1e3 * statistics.median(self._resets)

    def distinct(self, seeds: int) -> int:
        """Different first observations of so many seeds."""
        return len({self._env.reset(seed=seed)[0].tobytes() for seed in range(seeds)})

    def crash_rate(self, policy: str, seeds: int) -> float:
        """Share of the episodes of so many seeds in which a constant policy crashes."""
        crashes = 0
        for seed in range(seeds):
            self._env.reset(seed=seed)
            over, info = False, {"crashed": False}
            while not over:
                _, _, terminated, truncated, info = self._env.step(self._constant[policy])
                over = terminated or truncated
            crashes += bool(info["crashed"])
        return crashes / seeds


class Batch:
    """A batch of environments, which random actions drive: EnvPool's or, with seeded scenarios, the replica's.

    Args:
        backend: "envpool" or "replica".
        config: of the replica's environments; EnvPool drives its own default.
        threads: that drive them.
    """

    def __init__(self, backend: str, task: str, config: dict[str, Any], threads: int) -> None:
        import numpy as np

        if backend == "envpool":
            import envpool

            self._envs: Any = envpool.make_gymnasium(f"{task}-v0", num_envs=BATCH, num_threads=threads)
        else:
            import gymnasium as gym

            settings: dict[str, Any] = {"scenarios": "seeded", "config": config, "threads": threads}
            self._envs = gym.make_vec(f"sumo_env:replica/{task}-v0", num_envs=BATCH, **settings)
        self._envs.reset()
        self._rng, self._actions = np.random.default_rng(0), 3 if task == "intersection" else 5
        self.rate(0.0)

    def rate(self, seconds: float) -> tuple[float, float]:
        """Policy steps per second of processor time and of wall time; a step that is a reset counts."""
        begun, cpu, steps = time.perf_counter(), time.process_time(), 0
        while steps < LEAST * BATCH or time.perf_counter() - begun < seconds:
            self._envs.step(self._rng.integers(self._actions, size=BATCH).astype("int32"))
            steps += BATCH
        return steps / (time.process_time() - cpu), steps / (time.perf_counter() - begun)


class Learners:
    """Updates of our DQN and of Stable-Baselines3's on the same network and batch size, from full replays."""

    def __init__(self, network: str) -> None:
        import gymnasium as gym
        import numpy as np
        import stable_baselines3
        import torch
        from stable_baselines3.common.logger import configure
        from stable_baselines3.dqn.policies import DQNPolicy, QNetwork

        from agents.dqn import DQN, DQNConfig
        from agents.models import network_class

        class Policy(DQNPolicy):
            """Stable-Baselines3's with our network inside."""

            def make_q_net(self) -> QNetwork:
                outer = super().make_q_net()
                inner = network_class(network)(env.observation_space, int(env.action_space.n))
                outer.q_net = torch.nn.Sequential(torch.nn.Unflatten(1, env.observation_space.shape), inner)
                return outer

        torch.set_num_threads(1)
        env: Any = gym.Env()  # nobody drives it
        env.observation_space, env.action_space = gym.spaces.Box(-1.0, 1.0, (5, 5)), gym.spaces.Discrete(5)
        config = DQNConfig(network=network, replay_capacity=STORED)
        self._batch = config.batch_size
        self._own = DQN(config, env.observation_space, env.action_space, 0)
        make: Any = stable_baselines3.DQN
        sizes = {"learning_rate": config.learning_rate, "buffer_size": STORED}
        self._other = make(Policy, env, device="cpu", **sizes)
        self._other.set_logger(configure(None, []))
        rng = np.random.default_rng(0)
        for _ in range(STORED):
            before, after = rng.uniform(-1.0, 1.0, (2, 5, 5)).astype(np.float32)
            action, reward, end = int(rng.integers(5)), rng.random(), rng.random() < 0.1
            self._own.replay.add(before, action, reward, after, end)
            one = (np.array([value]) for value in ([action], reward, end))
            self._other.replay_buffer.add(before[None], after[None], *one, [{}])
        self._own.standardise()

    def own(self, updates: int) -> float:
        """Updates of ours per second of processor time."""
        start = time.process_time()
        for _ in range(updates):
            self._own.update()
        return updates / (time.process_time() - start)

    def other(self, updates: int) -> float:
        """Gradient steps of Stable-Baselines3, which moves its target network elsewhere."""
        start = time.process_time()
        self._other.train(gradient_steps=updates, batch_size=self._batch)
        return updates / (time.process_time() - start)


if __name__ == "__main__":
    _answer(*sys.argv[1:])
