"""Plans that ask what a study may ask beside the default one, by the label of made-up results."""

from __future__ import annotations

from experiments.analysis.plan import Bound, Family, Learner, Plan
from experiments.study.design.sheet import GRID

MIXED = Plan(  # does mixed training keep the gain without the price?
    version=3,
    families=(
        Family("benefits", "primary", "risky"),
        Family("harms", "primary", "regular"),
        Family("benefits of mixed training", "primary", "risky", arm="mixed"),
        Family("harms of mixed training", "primary", "regular", arm="mixed"),
        Family("paper", "return", "sum"),
    ),
    price=(Bound("mixed", "treatment", "risky", 0.05), Bound("mixed", "control", "regular", 0.025)),
    hopeless={"two-way": ("10+4", "15+6")},
    learner=Learner(),
)
BELIEF = Plan(  # do two agents, weighed by a belief?
    version=4,
    settings=tuple((task, names[0]) for task, names in GRID.items()),
    families=(),
    price=(
        Bound("belief", "two-treatment", "risky", 0.05),
        Bound("belief", "two-control", "regular", 0.025),
        Bound("belief", "one-treatment", "risky", 0.05),
        Bound("belief", "one-control", "regular", 0.025),
    ),
    learner=Learner(),
    trained=("treatment", "mixed"),
)
PLANS = {"of mixed training": MIXED, "of a belief": BELIEF}
