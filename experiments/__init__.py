"""The study. The modules here are the commands that a user types; the packages are what they are made of.

support    errors, files, provenance
study      grid -> train -> evaluate -> stored cells (sweep.py)
backends   the simulators behind one function
analysis   stored cells -> effects and verdicts (report.py)
reporting  effects -> report.html
validation, calibration  the parts of validate.py and calibrate.py
"""
