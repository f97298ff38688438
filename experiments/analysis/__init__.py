"""From stored cells to effects and verdicts: pure functions of frames, no files, no pictures, no sentences.

plan      what is compared and what decides, as data
cells     which stored cells may be compared with each other
scores    episodes to the outcomes of every agent in every scenario
estimate  inference with the trained agent as the unit
effects   the average treatment effect of every setting, and the one mean over settings
gates     did an agent learn, and has the learner finished?
frontier  how much more often agents crash than careful and constant drivers
claims    what the effects say about each claim
analysis  all of it as one value, with comparisons whose truth is known
"""
