"""Double DQN (van Hasselt et al. 2016) on any network: its settings, the update, and the loop of a training.

All draws are the seed's, and every episode begins with ``env.reset(seed=...)``: a training that is killed is begun
again, and gives the same bits.
"""

import math
from collections.abc import Callable, Sequence
from copy import deepcopy
from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from threadpoolctl import threadpool_limits
from torch import Tensor, nn
from torch.nn import functional

from agents.episodes import Episodes
from agents.greedy import Greedy, best
from agents.learner import Trained, check_numbers
from agents.models import Network, Standardised, flatten, network_class, unflattened
from agents.replay_memory import Batch, Replay, Step, transitions
from agents.streams import episode_seed, number, stream


@dataclass(frozen=True)
class DQNConfig:
    """Every setting of the learner; the defaults are the profile "tuned" (measurements: docs/learner.md).

    Settings whose origin is not named are of this project. ValueError for a value that makes no sense.
    """

    network: str = "attention"  # "attention", "dueling" (the paper's), or FILE:CLASS
    # The budget is counted in updates, so that it is the same for both arms (the paper's 3072 episodes give them
    # unequal numbers of updates).
    updates: int = 10_000
    steps_per_update: int = 4  # environment steps between two updates
    learning_rate: float = 5e-4  # of Adam (paper)
    learning_rate_final: float = 0.0  # reached linearly at the last update
    gamma: float = 0.95  # discount a step (paper: .99)
    n_steps: int = 3  # rewards in a goal, at most: it ends before the next random action
    batch_size: int = 128  # (paper: 100)
    clip_goals: bool = True  # at what the rewards met so far allow at this discount, see `DQN.bounds`
    horizon: int = (
        0  # steps after which every episode is terminated, which bounds goals further; 0: there is none
    )
    max_grad_norm: float = 10.0  # of the whole gradient (Stable-Baselines3)
    target_interval: int = 1  # updates between two moves of the target network towards the online network
    tau: float = 0.005  # how far it moves, 1 is a copy (Lillicrap et al. 2016)
    replay_capacity: int = 50_000  # transitions (rl-agents)
    warm_up: int = 1000  # random steps before the first update
    standardise: bool = True  # inputs, with mean and standard deviation of the warm-up
    epsilon_final: float = 0.1  # share of random actions in the limit (rl-agents)
    epsilon_decay: float = 0.15  # time constant of the decay from 1, share of the steps
    block: int = 20  # updates in a row; the steps they use are played before, in whole episodes
    probe_size: int = 256  # the first observations of an agent, on which its Q-values are watched
    probe_interval: int = 500  # updates between two looks at them
    device: str = "cpu"  # or "cuda"
    # the network attention on the CPU is compiled by numba: torch's mathematics in half the time, other last bits
    by_hand: bool = True

    def __post_init__(self) -> None:
        check_numbers(self, may_be_0=("learning_rate_final", "epsilon_final", "horizon"))
        if self.gamma >= 1:
            raise ValueError(f"gamma must be below 1, got {self.gamma!r}")
        for name in ("tau", "learning_rate_final", "epsilon_final"):
            if getattr(self, name) > 1:
                raise ValueError(f"{name} must be at most 1, got {getattr(self, name)!r}")

    @property
    def steps(self) -> int:
        """Environment steps of a training, without the end of its last episode."""
        return self.warm_up + self.steps_per_update * self.updates

    @property
    def is_by_hand(self) -> bool:
        """Whether the update is compiled (`agents.compiled`) and not torch's."""
        return self.by_hand and (self.network, self.device) == ("attention", "cpu")

    @property
    def packages(self) -> tuple[str, ...]:
        """See `agents.learner`."""
        return ("numba",) if self.is_by_hand else ()

    def epsilon(self, step: int) -> float:
        """Probability of a random action at an agent's ``step``-th environment step."""
        after = max(step - self.warm_up, 0) / (self.epsilon_decay * self.steps_per_update * self.updates)
        return (
            1.0 if step < self.warm_up else self.epsilon_final + (1.0 - self.epsilon_final) * math.exp(-after)
        )

    def rate(self, update: int) -> float:
        """Learning rate of the ``update``-th update, counted from 0."""
        return self.learning_rate + (self.learning_rate_final - self.learning_rate) * min(
            update / self.updates, 1.0
        )


class DQN:
    """One learning agent.

    Its weights, exploration and batches depend on ``seed`` and on what it is shown, and on nothing else; torch's global
    generator is seeded for networks that draw from it. ``network``: overrides the one that the config names.
    ``clipped``: how many goals of updates so far were beyond the bounds of a whole episode.

    Raises ValueError for a negative seed, and for spaces that a DQN cannot handle.
    """

    def __init__(
        self,
        config: DQNConfig,
        observations: gym.Space,
        actions: gym.Space,
        seed: int,
        network: Network | None = None,
    ) -> None:
        space, self.actions = _sizes(observations, actions)
        self.config = config
        self.seed = seed
        self.updates = self.clipped = 0
        self.least = self.most = 0.0  # of all rewards met so far, and of none
        self.horizon = config.horizon or math.inf
        self.replay = Replay(config.replay_capacity, space.shape)
        self._exploration = stream(seed, "exploration")
        self._sampling = stream(seed, "replay")

        torch.manual_seed(number(seed, "network"))
        inner = (network or network_class(config.network))(space, self.actions)
        self.online = Standardised(inner, space).to(config.device)
        self.target = deepcopy(self.online).requires_grad_(False).eval()
        # All weights lie in one vector, so that Adam, the norm and the target's moves are one operation each.
        self._weights, self._target_weights = flatten(self.online), flatten(self.target)
        self._optimizer = torch.optim.Adam([self._weights], lr=config.learning_rate, fused=True)
        self._by_hand = None
        if config.is_by_hand and network is None:
            from agents.compiled import ByHand  # needs numba

            self._by_hand = ByHand(self.online, self.target, self._weights, self._target_weights)

    def act(self, observation: np.ndarray, epsilon: float) -> tuple[int, bool]:
        """A random action with probability ``epsilon``, else the greedy one; and which of them it is."""
        if self._exploration.random() < epsilon:
            return int(self._exploration.integers(self.actions)), True
        return best(self.q(observation[None])[0]), False

    def remember(self, episode: Sequence[Step]) -> None:
        """Store the transitions of an episode. Raises ValueError for one that goes on beyond the horizon."""
        if len(episode) > self.horizon or (len(episode) == self.horizon and not episode[-1].terminated):
            raise ValueError(
                f"horizon is {self.horizon}, but after {len(episode)} steps an episode was not terminated: give the "
                "steps of a time limit that terminates episodes, or 0"
            )
        for transition in transitions(episode, self.config.gamma, self.config.n_steps, self.horizon):
            self.replay.add(transition)
        rewards = [step.reward for step in episode]
        self.least, self.most = min(self.least, *rewards), max(self.most, *rewards)

    @torch.inference_mode()
    def q(self, observations: np.ndarray) -> np.ndarray:
        """Q of every action, (n, actions), for some observations (n, ...)."""
        if self._by_hand:
            return self._by_hand.online(observations)
        x = torch.as_tensor(observations, dtype=torch.float32, device=self.config.device)
        if self.online.training:  # setting the mode takes a fifth of the time of acting
            self.online.eval()
        return self.online(x).cpu().numpy()

    def standardise(self) -> None:
        """Fix the statistics of the inputs by what is in the replay."""
        seen = torch.from_numpy(self.replay.first(len(self.replay))).to(self.config.device)
        for network in (self.online, self.target):
            network.fit(seen)

    def bounds(self, left: Any) -> tuple[Any, Any]:
        """What no discounted sum of rewards like those met so far is below or above, in so many steps (a float, or a
        tensor of them); an episode may end at any time.

        So a goal beyond is an error of the target network. Rewards that are still to be met extend the bounds before
        they are in any batch.
        """
        steps = (1.0 - self.config.gamma**left) / (1.0 - self.config.gamma)
        return self.least * steps, self.most * steps

    def _limits(self, batch: Batch) -> tuple[Tensor, Tensor] | None:
        """Of the goals of a batch, as float32."""
        if not self.config.clip_goals:
            return None
        least, most = self.bounds(batch.left)
        return least.float(), most.float()

    def _count(self, goals: Tensor) -> None:
        """Note goals as only diverging values make them: near a time limit, noise alone exceeds a goal's own limit."""
        least, most = self.bounds(self.horizon)
        self.clipped += self.config.clip_goals * int(((goals < least) | (goals > most)).sum())

    def update(self) -> Tensor:
        """One gradient step on a batch from the replay, then a move of the target network.

        Returns the mean squared temporal-difference error of the batch, before that step.
        """
        config = self.config
        batch = self.replay.sample(self._sampling, config.batch_size, config.device)
        rate = config.rate(self.updates)
        self.updates += 1
        tau = config.tau if self.updates % config.target_interval == 0 else 0.0
        if self._by_hand:
            adam, limits = self._optimizer.state[self._weights], self._limits(batch)
            loss, goals = self._by_hand.update(batch, adam, limits, config.max_grad_norm, rate, tau)
            self._count(torch.from_numpy(goals))
            return torch.tensor(loss)
        return self._update(batch, rate, tau)

    def _update(self, batch: Batch, rate: float, tau: float) -> Tensor:
        loss = self._gradient(batch)
        nn.utils.clip_grad_norm_([self._weights], self.config.max_grad_norm)
        self._optimizer.param_groups[0]["lr"] = rate
        self._optimizer.step()
        if tau:
            with torch.no_grad():
                self._target_weights.lerp_(self._weights, tau)
                for target, online in zip(self.target.buffers(), self.online.buffers(), strict=True):
                    target.copy_(online)
        return loss

    def _gradient(self, batch: Batch) -> Tensor:
        """Write the gradient of the loss on a batch; returns the loss."""
        if not self.online.training:
            self.online.train()
        # The online network chooses the next action, the target network values it.
        with torch.no_grad():
            chosen = self.online(batch.next_observations).argmax(1, keepdim=True)
            value = self.target(batch.next_observations).gather(1, chosen).squeeze(1)
            goal = batch.rewards + batch.discounts * value
            self._count(goal)
            if limits := self._limits(batch):
                goal = goal.clamp(*limits)

        # Squared error, never Huber's with delta 1: at gamma .99 that prices a crash at one step of reward.
        q = self.online(batch.observations).gather(1, batch.actions[:, None]).squeeze(1)
        loss = functional.mse_loss(q, goal)
        self._optimizer.zero_grad(set_to_none=False)
        loss.backward()
        return loss.detach()

    def policy(self) -> Greedy:
        """The greedy policy as it is now, on the CPU (a copy)."""
        kind = greedy(self.config) if self._by_hand else Greedy
        return kind(unflattened(self.online).cpu())


class Training:
    """One agent in training, with everything that is written down about it."""

    def __init__(self, agent: DQN, env: gym.Env[Any, Any]) -> None:
        self.agent, self.env = agent, Episodes(env)
        self.probe: np.ndarray | None = None  # its first observations, on which its Q-values are watched
        # rows of update, mean and largest of max_a |Q| on the probe: the signs of divergence
        self.probe_q: list[list[float]] = []
        self.goals_clipped: list[list[float]] = []  # rows of update, and share clipped since the row before
        self._clipped = 0

    def play(self, steps: int) -> None:
        """Play whole episodes until the agent has made at least so many steps in all."""
        while self.env.steps < steps:
            self._play_episode()

    def _play_episode(self) -> None:
        observation, _ = self.env.reset(seed=episode_seed(self.agent.seed, len(self.env.rows["episode"])))
        episode: list[Step] = []
        ended = False
        while not ended:
            action, is_random = self.agent.act(observation, self.agent.config.epsilon(self.env.steps))
            after, reward, terminated, truncated, _ = self.env.step(action)
            episode.append(Step(observation, action, float(reward), after, bool(terminated), is_random))
            observation, ended = after, terminated or truncated
        self.agent.remember(episode)

    def watch(self) -> None:
        """Note the Q-values on the probe, and how many goals were clipped."""
        if self.probe is None:
            self.probe = self.agent.replay.first(self.agent.config.probe_size)
        size, updates = np.abs(self.agent.q(self.probe)).max(1), self.agent.updates
        since = updates - (self.probe_q[-1][0] if self.probe_q else 0)
        self.probe_q.append([updates, float(size.mean()), float(size.max())])
        share = (self.agent.clipped - self._clipped) / (since * self.agent.config.batch_size)
        self.goals_clipped.append([updates, share])
        self._clipped = self.agent.clipped

    def trained(self) -> Trained:
        """What is left when it is over."""
        record: dict[str, Any] = {
            "steps": self.env.steps,
            "updates": self.agent.updates,
            "probe_q": self.probe_q,
            "q_bound": max(map(abs, self.agent.bounds(self.agent.horizon))),
        }
        if self.agent.config.clip_goals:
            record["goals_clipped"] = self.goals_clipped
        return Trained(self.agent.policy(), self.env.columns(), record)


def train(
    env: gym.Env[Any, Any],
    config: DQNConfig,
    seed: int,
    *,
    progress: Callable[[int], None] = lambda _: None,
) -> Trained:
    """Train an agent on ``env`` for ``config.updates`` updates.

    It plays whole episodes until it has made ``config.warm_up`` steps and ``config.steps_per_update`` more for each
    update of the next block, then makes these updates. Torch and the libraries for matrices are set to one thread for
    the whole process: the order of summation, hence the bits, depends on it, and processes do the parallel work.

    Args:
        env: observations are boxes of any shape, actions ``Discrete``; ``info`` may hold crashed, which
            is logged. Every episode begins with ``reset(seed=...)``.
        config: the settings.
        seed: agents with one seed start with equal weights and meet the same scenarios.
        progress: called with environment steps after every block of updates; what it raises ends the training.

    Raises:
        ValueError: spaces that a DQN cannot handle, or an unknown network.
    """
    agent = DQN(config, env.observation_space, env.action_space, seed)
    torch.set_num_threads(1)
    threadpool_limits(1)  # after all of them are loaded
    training = Training(agent, env)
    while (updates := agent.updates) < config.updates:
        done = min(updates + config.block, config.updates)
        training.play(config.warm_up)
        if updates == 0 and config.standardise:
            agent.standardise()
        training.play(config.warm_up + config.steps_per_update * done)
        while agent.updates < done:
            agent.update()
        if done // config.probe_interval > updates // config.probe_interval or done == config.updates:
            training.watch()
        progress(config.warm_up + config.steps_per_update * done)
    return training.trained()


def greedy(config: DQNConfig) -> type[Greedy]:
    """The kind of policy that such a learner makes."""
    if not config.is_by_hand:
        return Greedy
    from agents.compiled import Compiled  # needs numba

    return Compiled


def _sizes(observations: gym.Space, actions: gym.Space) -> tuple[gym.spaces.Box, int]:
    if (
        isinstance(observations, gym.spaces.Box)
        and isinstance(actions, gym.spaces.Discrete)
        and actions.start == 0
    ):
        return observations, int(actions.n)
    raise ValueError(f"A DQN needs Box observations and Discrete actions from 0: {observations}, {actions}")
