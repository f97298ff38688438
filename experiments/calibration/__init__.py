"""Fits SUMO's drivers, and the risk events of a dose, to highway-env: the parts of `experiments/calibrate.py`.

spaces      what may be changed, by task
search      an optimiser (optuna) that goes on where it was stopped
drivers     the distance of SUMO's regular traffic from highway-env's
doses       dose and response in both simulators, and how far they are from what a dose is meant to do
"""
