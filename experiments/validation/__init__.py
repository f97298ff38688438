"""How far a simulator is from highway-env: the parts of `experiments/validate.py`.

egos         who drives through the traffic
episodes     whole episodes in any simulator, one row of measures each
parts        all of them in parallel processes, resumable
compare      paired differences, their intervals, the order of egos
checks       margins, and the checks of a task and level with their verdicts
page         what a person reads
status       what is known before a sweep trains
"""
