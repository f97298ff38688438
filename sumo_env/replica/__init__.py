"""The replica: highway-env's physics, compiled with numba, without SUMO.

It is highway-env's traffic up to rounding and its numbers (positions within 1e-6 m over whole episodes, the same
endings), hundreds of times faster, behind the environment, the observations and the rewards of `sumo_env`.
"""
