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
run          hands tasks to an executor and tries again what dies
attempt      one try at a task, in whatever process
executors/   processes of this machine, Ray, Slurm
store        finished cells on disk, one folder each
pack, packed finished cells in a few tables: written, and read
results      all of them as tables
rerun        a stored episode again
avoid        whether a stored crash could have been avoided
avoidable    how many of a folder's crashes could
planning     what planners reach that act in copies
rows         a table that goes on where it was stopped
estimate     how long it will take
progress     what a person sees meanwhile
"""
