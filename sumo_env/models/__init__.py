"""Driver models of the ``matched`` traffic: compiled functions of arrays that know no simulator.

Each reproduces one rule of highway-env 1.12.1 and is tested against it: `idm` (car following), `mobil` (lane
changes), `give_way` (the intersection's right of way). `lane_table` holds the lanes that they drive on.
"""
