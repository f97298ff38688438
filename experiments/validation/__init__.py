"""How far SUMO is from highway-env, in numbers: the parts of `experiments/validate.py`.

margins     what is asked for, written down before anything was measured
stage       scenes of one or a few vehicles, driven in either simulator
dynamics    checks on those scenes: car following, ego response, geometry
changes     lane-change decisions on the highway against MOBIL's criteria
episodes    whole paired episodes, one row of measures each
jobs        all of that in parallel processes, resumable
compare     paired differences, equivalence, noise floors
scorecard   the checks of a task and level
figures, page  what a person reads
status      what a report may say about a version
"""

from __future__ import annotations

from experiments.validation.status import validation_status

__all__ = ["validation_status"]
