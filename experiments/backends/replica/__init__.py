"""The replica: highway-env's physics, compiled with numba, without SUMO."""
