"""From stored cells to effects and verdicts: pure functions, no files, no pictures.

plan         what is compared and what decides, as data
tables       episodes to scores of every agent
gates        did an agent learn?
statistics   inference with the trained agent as the unit
effects      the average treatment effect of every task and level
pooling      over levels and tasks: the primary answer, heterogeneity, slopes
placebo      comparisons whose truth is known
sensitivity  the primary answer in other ways; the next batch of seeds
exploratory  what is looked at beside the plan: further arms, doses, transfer, kinds of crashes
verdicts     what that says about each claim
headline     the answer in words
analysis     all of it as one value
"""
