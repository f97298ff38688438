"""Policies and the learner: double DQN on torch, and drivers that do not learn.

Knows gymnasium, numpy and torch; knows no simulator and no task by name.

    learner        the contract of a learner; learners: all by name
    dqn            double DQN: settings, update, loop; sb3: DQN and PPO of Stable-Baselines3
    compiled       the update of dqn without torch, by the kernels of numba in `kernels`
    episodes       what is written down about training episodes
    models         Q-networks: the paper's dueling network, ego attention, inputs standardised
    replay_memory  past transitions, drawn uniformly
    files          atomic files, and arrays in them, of which damage is detected
    greedy         the policy of a trained network, and its file
    extra_column   a number beside what an agent observes
    policies       what drives: the interface, models of Stable-Baselines3, objects of a user's file
    plugins        FILE:NAME; reading: the files that it reads
    pretrained     trained agents to load: `agents.load("u-turn-3", "treatment")`
    streams        named random streams
    rules/         idle, random, faster, slower, idm and careful, by name, and what the last two see
"""

from agents.pretrained import card, cards, load

__all__ = ["card", "cards", "load"]
