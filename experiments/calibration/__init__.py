"""SUMO's drivers and the dose of risk, fitted to highway-env: the parts of `experiments/calibrate.py`.

spaces      what is searched, task by task
objectives  what is made small
search      the optimiser
figures     dose and response
"""
