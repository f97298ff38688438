"""The experiment itself, from its description to stored cells.

arms         the traffic that agents are trained and tested in
experiment   what an experiment consists of, and its cells
presets      named experiments, which options change
grid         a cell, its name, and what the name is made of
fingerprint  what a simulator does, as eight digits
wrappers     what a task's training changes about its environment
policies     the policy of a cell
train        one agent in its traffic, resumable
evaluate     a policy on the test scenarios
cell         what is computed for a cell: train, test, store
run          hands tasks to an executor, tries again what dies; what a process does with a task
executors/   processes of this machine, Ray, Slurm
store        the directory of results: finished cells, one folder each or packed; all of them as frames
packed       finished cells in a few tables
rerun        a stored episode again
avoid        whether a stored crash could have been avoided
progress     how long it will take, and what a person sees meanwhile
"""
