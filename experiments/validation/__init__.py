"""How far a simulator is from highway-env: the parts of `experiments/validate.py`.

margins      what is asked for
egos         who drives through the traffic
episodes     whole episodes in any simulator, one row of measures each
parts        all of them in parallel processes, resumable
mobil        lane changes of the highway against MOBIL's criteria
compare      paired differences, their intervals, the order of egos
checks       the checks of a task and level, with their verdicts
page, figures  what a person reads
status       what a sweep and its report may say before training
"""
