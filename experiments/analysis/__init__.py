"""From stored cells to effects and verdicts: pure functions, no files, no pictures.

tables      episodes to one row a policy
gates       is an agent worth comparing?
statistics  inference with the trained agent as the unit
effects     the average treatment effect of every task and level
pooling     over levels and tasks
verdicts    what that says about each claim
analysis    all of it as one value
"""
