"""Double DQN (van Hasselt et al. 2016) with the paper's dueling network: configuration and learner."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from agents.architecture import Architecture
from agents.bootstrap import TargetValues
from agents.kernels import adam
from agents.network import Activations, Network
from agents.policy import GreedyPolicy, q_values
from agents.replay import Replay
from agents.streams import generator_state, restore_generator, stream
from agents.threads import one_thread

__all__ = ["DQN", "DQNConfig", "GreedyPolicy"]

_VECTORS = ("online", "target", "mean", "square")


@dataclass(frozen=True)
class DQNConfig:
    """Every hyper-parameter of the learner, with its source. ValueError for a value that makes no sense.

    Sources: "paper" is arXiv 2103.10245; "rl-agents" is the default of the code that the paper cites, where
    the paper is silent; "here" is a choice of this project, see docs/decisions.md.
    """

    # Budget in gradient updates; an agent makes warm_up more environment steps than updates (here; paper:
    # 3072 episodes, which give the two arms unequal numbers of updates).
    updates: int = 20_000
    learning_rate: float = 5e-4  # of Adam (paper)
    gamma: float = 0.99  # discount a step (paper); the published configurations of these tasks use .8 to .95
    batch_size: int = 100  # (paper)
    hidden: tuple[int, ...] = (256, 192, 128)  # shared layers (paper)
    stream: tuple[int, ...] = (128, 128)  # hidden layers of each of the two streams (paper)
    head: str = "mean"  # Q = V + A - mean A (rl-agents), or "sum": Q = V + A (as the paper prints it)
    double: bool = (
        True  # the online network chooses the next action, the target network values it (rl-agents)
    )
    target_lag: int = (
        500  # updates between copies to the target network (here; rl-agents' 1 diverges at gamma .99)
    )
    gradient_clamp: float = 1.0  # each entry of the gradient is clamped to +-this (rl-agents)
    replay_capacity: int = 50_000  # transitions (rl-agents)
    warm_up: int = 100  # environment steps ahead of the first update: a batch (rl-agents)
    epsilon_start: float = 1.0  # share of random actions at the first step (rl-agents)
    epsilon_final: float = 0.1  # and in the limit (rl-agents)
    epsilon_decay: float = (
        0.15  # time constant of the decay, share of the updates (here; rl-agents: 5000 steps)
    )
    block: int = 20  # updates in a row; the steps they use are played before, in whole episodes (here)
    adam_beta1: float = 0.9  # (PyTorch)
    adam_beta2: float = 0.999  # (PyTorch)
    adam_epsilon: float = 1e-8  # (PyTorch)
    probe_size: int = 256  # the first observations of an agent, on which its Q-values are watched (here)
    probe_interval: int = 500  # updates between two looks at them (here)

    def __post_init__(self) -> None:
        for name in ("updates", "batch_size", "target_lag", "replay_capacity", "block", "probe_size"):
            self._check_whole(name, 1)
        self._check_whole("probe_interval", 1)
        self._check_whole("warm_up", 0)
        for name in ("learning_rate", "gradient_clamp", "epsilon_decay", "adam_epsilon"):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name} must be greater than 0, got {getattr(self, name)!r}.")
        for name in ("gamma", "adam_beta1", "adam_beta2"):
            if not 0 < getattr(self, name) < 1:
                raise ValueError(
                    f"{name} must lie between 0 and 1, both excluded, got {getattr(self, name)!r}."
                )
        if not 0 <= self.epsilon_final <= self.epsilon_start <= 1:
            raise ValueError(
                "Exploration needs 0 <= epsilon_final <= epsilon_start <= 1, "
                f"got epsilon_start={self.epsilon_start!r} and epsilon_final={self.epsilon_final!r}."
            )
        # Lists come out of JSON; tuples keep the config hashable.
        object.__setattr__(self, "hidden", tuple(self.hidden))
        object.__setattr__(self, "stream", tuple(self.stream))
        self.architecture(inputs=1, actions=1)  # refuses impossible layers and unknown heads

    def _check_whole(self, name: str, least: int) -> None:
        value = getattr(self, name)
        if type(value) is not int or value < least:
            raise ValueError(f"{name} must be a whole number of at least {least}, got {value!r}.")

    def architecture(self, inputs: int, actions: int) -> Architecture:
        """The network for observations of ``inputs`` numbers and ``actions`` discrete actions."""
        return Architecture(inputs, actions, self.hidden, self.stream, self.head)

    def epsilon(self, step: int) -> float:
        """Probability of a random action at an agent's ``step``-th environment step."""
        decay = math.exp(-step / (self.epsilon_decay * self.updates))
        return self.epsilon_final + (self.epsilon_start - self.epsilon_final) * decay


class DQN:
    """One learning agent. ``inputs``: length of the flattened observation; ``actions``: number of actions.

    Its weights, exploration and batches depend on ``seed`` and on what it is shown, and on nothing else.

    Sets numpy's matrix products to one thread for the whole process: the order of summation, hence the bits,
    depends on the number of threads. Raises ValueError for a negative seed.
    """

    def __init__(self, config: DQNConfig, inputs: int, actions: int, seed: int) -> None:
        one_thread()
        self.config = config
        self.seed = seed
        self.architecture = config.architecture(inputs, actions)
        self.updates = 0
        self.replay = Replay(config.replay_capacity, inputs)
        self._exploration = stream(seed, "exploration")
        self._sampling = stream(seed, "replay")

        # Weights, target weights, gradient and Adam's two moments are vectors of one shape.
        self._online, self._target, self._gradient, self._mean, self._square = (
            Network(self.architecture) for _ in range(5)
        )
        initial = self.architecture.initial(stream(seed, "network initialisation"))
        for network in (self._online, self._target):
            network.flat[:] = initial

        batch = config.batch_size
        self._each = np.arange(batch)
        self._observations = np.zeros((2 * batch, inputs), np.float32)  # s, then s': one pass serves both
        self._error = np.zeros(batch, np.float32)
        self._q_gradient = np.zeros((batch, actions), np.float32)
        self._online_pass = Activations(self.architecture, 2 * batch, gradient_rows=batch, ranked_rows=batch)
        self._target_values = TargetValues(self._target, self.replay, config.target_lag, batch)

    def q(self, observation: np.ndarray) -> np.ndarray:
        """Q of every action, float32 (actions,), for one observation."""
        return q_values(self.architecture, self._online.layers, observation)

    def act(self, observation: np.ndarray, epsilon: float) -> int:
        """A random action with probability ``epsilon``, else the greedy one."""
        if self._exploration.random() < epsilon:
            return int(self._exploration.integers(self.architecture.actions))
        return int(np.argmax(self.q(observation)))

    def update(self) -> None:
        """One gradient step on a batch from the replay, and a target copy every ``target_lag`` updates.

        Raises ValueError when the replay is empty.
        """
        config, batch, replay, each = self.config, self.config.batch_size, self.replay, self._each
        rows = replay.sample(self._sampling, batch)
        np.take(replay.observations, rows, axis=0, out=self._observations[:batch], mode="clip")
        np.take(replay.next_observations, rows, axis=0, out=self._observations[batch:], mode="clip")
        actions = replay.actions[rows]

        q = self._online.forward(self._observations, self._online_pass)
        target_q = self._target_values.q(rows)
        chooser = q[batch:] if config.double else target_q
        bootstrap = target_q[each, chooser.argmax(1)]
        goal = replay.rewards[rows] + config.gamma * (1.0 - replay.terminated[rows]) * bootstrap
        np.subtract(q[each, actions], goal, out=self._error)
        # The loss is the mean squared error. Never Huber's with delta 1: at gamma .99 it prices a crash at
        # one step of reward.
        self._q_gradient[:] = 0.0
        self._q_gradient[each, actions] = self._error * (2.0 / batch)
        self._online.backward(self._observations[:batch], self._online_pass, self._q_gradient, self._gradient)
        self.updates += 1
        self._adam_step()
        if self.updates % config.target_lag == 0:
            self._target.flat[:] = self._online.flat
            self._target_values.forget()

    def _adam_step(self) -> None:
        config = self.config
        numbers = (
            config.gradient_clamp,
            config.learning_rate / (1.0 - config.adam_beta1**self.updates),
            config.adam_beta1,
            config.adam_beta2,
            math.sqrt(1.0 - config.adam_beta2**self.updates),
            config.adam_epsilon,
        )
        adam(
            self._online.flat,
            self._gradient.flat,
            self._mean.flat,
            self._square.flat,
            *map(np.float32, numbers),
        )

    def loss(self) -> float:
        """Mean squared temporal-difference error of the last update's batch, before that update."""
        return float(np.square(self._error).mean())

    def policy(self) -> GreedyPolicy:
        """The greedy policy as it is now (a copy)."""
        return GreedyPolicy(self.architecture, self._online.flat)

    def state_dict(self) -> dict[str, np.ndarray]:
        """Everything that the future depends on, as arrays.

        Views of live memory: copy them or write them to a file before the next step or update.
        """
        state = {name: getattr(self, f"_{name}").flat for name in _VECTORS}
        state |= {f"replay.{name}": array for name, array in self.replay.state_dict().items()}
        state["exploration"] = np.array(generator_state(self._exploration))
        state["sampling"] = np.array(generator_state(self._sampling))
        state["updates"] = np.array(self.updates)
        return state

    def load_state_dict(self, state: Mapping[str, np.ndarray]) -> None:
        """Put back a state from :meth:`state_dict`. Raises ValueError when it belongs to other sizes."""
        for name in _VECTORS:
            vector = getattr(self, f"_{name}").flat
            if state[name].shape != vector.shape:
                raise ValueError(
                    f"Expected {len(vector)} parameters in {name}, got shape {state[name].shape}."
                )
            vector[:] = state[name]
        prefix = "replay."
        self.replay.load_state_dict(
            {k.removeprefix(prefix): v for k, v in state.items() if k.startswith(prefix)}
        )
        self._target_values.forget()
        restore_generator(self._exploration, str(state["exploration"]))
        restore_generator(self._sampling, str(state["sampling"]))
        self.updates = int(state["updates"])
