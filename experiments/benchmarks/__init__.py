"""What `experiments/benchmark.py` measures, one module a question; every measurement in processes of its own.

remote        an object in another process; slices of work with wall and processor time
environments  steps a second of SUMO and highway-env, side by side; share of the engine; growth; memory
learner       updates a second against Stable-Baselines3 and against the bare matrix products
throughput    agents an hour of a whole sweep; steps a second of a vector of environments
sizes         how much a full and a quick run measure
targets       what the project has promised itself, beside what was measured
page          benchmark.html
"""
