"""How far a simulator is from highway-env: the parts of `experiments/validate.py`."""
