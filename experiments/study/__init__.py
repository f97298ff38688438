"""The experiment itself, from its description to stored cells: four rooms, of which each uses those before it.

design      what is asked for: traffic, arms, sheets of the tasks, cells and their names, presets
results     finished cells on disk, and the working folders of unfinished ones
compute     training, tests, and the processes that compute cells
replaying   stored episodes and agents again
"""
