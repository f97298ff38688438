"""A plan like the study's of a size that is quickly made up, by the label of made-up results."""

from __future__ import annotations

from dataclasses import replace

from experiments.analysis.plan import STUDY

LIGHTEST = (("highway", "50"), ("u-turn", "3"))
SMALL = replace(STUDY, stages={"a": LIGHTEST, "b": (*LIGHTEST, ("u-turn", "6"))}, seeds=2)
PLANS = {"study": STUDY, "small": SMALL}
