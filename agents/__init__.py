"""Policies and the learner: the paper's dueling DQN, and drivers that do not learn.

Knows gymnasium, numpy and numba; knows no simulator and no task by name.

    architecture   sizes of the dueling network
    policy         the greedy policy of a trained network, numpy only
    network        forward and hand-written backward pass over a batch
    kernels        its compiled parts between the products, and Adam
    threads        one thread for numpy's products
    replay         uniform replay memory
    bootstrap      the target network's values of the stored transitions
    dqn            configuration and learner
    training       the loop: whole episodes, then updates; resumable bit for bit
    checkpoint     atomic files that detect damage
    streams        named random streams
    rules          idle, random, faster, slower, idm and careful, by name
    idm            IDM and MOBIL through the meta-actions
    careful        the careful driver: plans by prediction
    perception     what the last two see in a kinematics observation
"""
