"""The experiment itself, from the grid to stored cells.

grid      the cells, their names, and what the names are made of
presets   named sizes
seeds     which scenarios are met
train     one agent in its traffic, resumable
evaluate  a policy on the test scenarios
worker    the process that computes cells
engine    supervises the workers
claims    who computes which cell
store     finished cells on disk
estimate  how long it will take
progress  what a person sees meanwhile
"""
