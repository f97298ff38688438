"""How far a simulator is from highway-env: the parts of `experiments/validate.py`.

episodes     who drives, and whole episodes in any simulator: one row of measures each
parts        all of them in parallel processes, resumable
checks       margins, paired differences, and the checks of a task and level with their verdicts
"""
