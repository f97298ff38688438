"""Policies and the learner: double DQN on torch, and drivers that do not learn.

Knows gymnasium, numpy and torch; knows no simulator and no task by name.

    models       Q-networks: the paper's dueling network, ego attention, inputs standardised
    dqn          settings and learner
    replay       uniform replay memory
    training     the loop: whole episodes, then updates; resumable bit for bit
    checkpoint   atomic files of arrays that detect damage
    greedy       the policy of a trained network, and its file
    policies     what drives: the interface, models of Stable-Baselines3, objects of a user's file
    plugins      FILE:NAME
    pretrained   trained agents to load: `agents.load("u-turn-3", "mixed")`
    streams      named random streams
    rules/       idle, random, faster, slower, idm and careful, by name, and what the last two see
"""

from agents.pretrained import card, cards, load

__all__ = ["card", "cards", "load"]
