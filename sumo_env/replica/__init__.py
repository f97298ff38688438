"""The replica: highway-env's physics, compiled with numba, without SUMO.

It is highway-env's traffic up to rounding and its numbers (positions within 1e-6 m over whole episodes, the same
endings), hundreds of times faster, behind the environment, the observations and the rewards of `sumo_env`.

env        the environments
vector     many of them behind gymnasium's vector interface
batch      many episodes in one compiled call
pay        rewards and endings, for batches
simulator  `Replica`: an episode, one compiled call per policy step
tables     lanes, cars and risk events as record arrays
step       a sub-step, and the loop over those of a policy step
driving    route, car following (IDM), lane changes (MOBIL)
neighbours who is ahead of and behind whom
give_way   right of way at the intersection
motion     steering and the bicycle model
contacts   highway-env's test of contacts and what follows from one, and the time to collision
risk       cut-ins, sudden braking, surges
geometry, numpy_loops, compiled   what these are computed with
"""
