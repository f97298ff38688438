"""Double DQN (van Hasselt et al. 2016) with the paper's dueling network: configuration and learner."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch

from agents.architecture import Architecture
from agents.network import Activations, Network
from agents.policy import GreedyPolicy, q_values
from agents.replay import Replay
from agents.streams import generator_state, restore_generator, stream

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

    Sets torch to one thread for the whole process: at this size a second one costs more than it brings, and
    the order of summation, hence the bits, depends on their number. Raises ValueError for a negative seed.
    """

    def __init__(self, config: DQNConfig, inputs: int, actions: int, seed: int) -> None:
        torch.set_num_threads(1)
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
            network.flat.copy_(torch.from_numpy(initial))
        self._online.flat.grad = self._gradient.flat
        self._adam = torch.optim.Adam(
            [self._online.flat],
            lr=config.learning_rate,
            betas=(config.adam_beta1, config.adam_beta2),
            eps=config.adam_epsilon,
            fused=True,
        )
        self._adam_step = torch.tensor(0.0)
        self._adam.state[self._online.flat] = {
            "step": self._adam_step,
            "exp_avg": self._mean.flat,
            "exp_avg_sq": self._square.flat,
        }
        # Acts on the weights as they are after the last update: the arrays share the tensor's memory.
        self._acting = self.architecture.split(self._online.flat.numpy())

        batch = config.batch_size
        self._observations = torch.zeros(2 * batch, inputs)  # s, then s': one forward pass serves both
        self._actions = torch.zeros(batch, 1, dtype=torch.int64)
        self._rewards = torch.zeros(batch, 1)
        self._terminated = torch.zeros(batch, 1)
        self._error = torch.zeros(batch, 1)
        self._q_gradient = torch.zeros(batch, actions)
        self._online_pass = Activations(self.architecture, 2 * batch, gradient_rows=batch)
        self._target_pass = Activations(self.architecture, batch)

    def q(self, observation: np.ndarray) -> np.ndarray:
        """Q of every action, float32 (actions,), for one observation."""
        return q_values(self.architecture, self._acting, observation)

    def act(self, observation: np.ndarray, epsilon: float) -> int:
        """A random action with probability ``epsilon``, else the greedy one."""
        if self._exploration.random() < epsilon:
            return int(self._exploration.integers(self.architecture.actions))
        return int(np.argmax(self.q(observation)))

    def update(self) -> None:
        """One gradient step on a batch from the replay, and a target copy every ``target_lag`` updates.

        Raises ValueError when the replay is empty.
        """
        config, batch = self.config, self.config.batch_size
        self._sample()
        # Denormal numbers (Adam's moments of units that died) would slow the arithmetic down.
        torch.set_flush_denormal(True)
        q = self._online.forward(self._observations, self._online_pass)
        target_q = self._target.forward(self._observations[batch:], self._target_pass)
        chooser = q[batch:] if config.double else target_q
        bootstrap = target_q.gather(1, chooser.argmax(1, keepdim=True))
        goal = self._rewards + config.gamma * (1.0 - self._terminated) * bootstrap
        torch.sub(q[:batch].gather(1, self._actions), goal, out=self._error)
        # The loss is the mean squared error. Never Huber's with delta 1: at gamma .99 it prices a crash at
        # one step of reward.
        self._q_gradient.zero_().scatter_(1, self._actions, self._error * (2.0 / batch))
        self._online.backward(self._observations[:batch], self._online_pass, self._q_gradient, self._gradient)
        self._gradient.flat.clamp_(-config.gradient_clamp, config.gradient_clamp)
        self._adam.step()
        torch.set_flush_denormal(False)
        self.updates += 1
        if self.updates % config.target_lag == 0:
            self._target.flat.copy_(self._online.flat)

    def _sample(self) -> None:
        batch, replay = self.config.batch_size, self.replay
        rows = replay.sample(self._sampling, batch)
        observations = self._observations.numpy()
        np.take(replay.observations, rows, axis=0, out=observations[:batch], mode="clip")
        np.take(replay.next_observations, rows, axis=0, out=observations[batch:], mode="clip")
        self._actions.numpy()[:, 0] = replay.actions[rows]
        self._rewards.numpy()[:, 0] = replay.rewards[rows]
        self._terminated.numpy()[:, 0] = replay.terminated[rows]

    def loss(self) -> float:
        """Mean squared temporal-difference error of the last update's batch, before that update."""
        return float(self._error.square().mean())

    def policy(self) -> GreedyPolicy:
        """The greedy policy as it is now (a copy)."""
        return GreedyPolicy(self.architecture, self._online.flat.numpy())

    def state_dict(self) -> dict[str, np.ndarray]:
        """Everything that the future depends on, as arrays.

        Views of live memory: copy them or write them to a file before the next step or update.
        """
        state = {name: getattr(self, f"_{name}").flat.numpy() for name in _VECTORS}
        state |= {f"replay.{name}": array for name, array in self.replay.state_dict().items()}
        state["exploration"] = np.array(generator_state(self._exploration))
        state["sampling"] = np.array(generator_state(self._sampling))
        state["updates"] = np.array(self.updates)
        return state

    def load_state_dict(self, state: Mapping[str, np.ndarray]) -> None:
        """Put back a state from :meth:`state_dict`. Raises ValueError when it belongs to other sizes."""
        for name in _VECTORS:
            vector = getattr(self, f"_{name}").flat
            if state[name].shape != tuple(vector.shape):
                raise ValueError(
                    f"Expected {len(vector)} parameters in {name}, got shape {state[name].shape}."
                )
            vector.copy_(torch.from_numpy(np.asarray(state[name])))
        prefix = "replay."
        self.replay.load_state_dict(
            {k.removeprefix(prefix): v for k, v in state.items() if k.startswith(prefix)}
        )
        restore_generator(self._exploration, str(state["exploration"]))
        restore_generator(self._sampling, str(state["sampling"]))
        self.updates = int(state["updates"])
        self._adam_step.fill_(float(self.updates))
