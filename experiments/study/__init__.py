"""The experiment itself, from the grid to stored cells.

arms         the traffic that agents are trained and tested in
grid         the cells, their names, and what the names are made of
presets      named sizes
fingerprint  what a simulator does, as eight digits
seeds        which scenarios are met
wrappers     what a task's training changes about its environment
policies     the policy of a cell
train        one agent in its traffic, resumable
evaluate     a policy on the test scenarios
cell         what is computed for a cell: train, test, store
run          hands tasks to an executor, tries again what dies; what a process does with a task
executors/   processes of this machine, Ray, Slurm
store        finished cells on disk: one folder each, or packed
packed       finished cells in a few tables
results      all of them as frames
rerun        a stored episode again
avoid        whether a stored crash could have been avoided
avoidable    how many of a folder's crashes could
planning     what planners reach that act in copies
rows         a table that goes on where it was stopped
estimate     how long it will take
progress     what a person sees meanwhile
"""
