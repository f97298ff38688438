"""The study. The modules here are the commands that a user types; the packages are what they are made of.

support    errors, files, provenance
backends   the simulators behind one function
study      cells -> train -> evaluate -> stored cells (sweep.py)
analysis   stored cells -> effects and verdicts (report.py)
reporting  effects -> report.html
validation the parts of validate.py

Importing anything of it limits numerical libraries to one thread in this process and those that it starts: processes
do the parallel work, and the bits of a sum depend on the number of threads.
"""

from experiments.support import limit_threads

limit_threads()
