"""Random networks and demand: vehicles of 1 to 120 m, ways that end anywhere, and what changes or ends them."""

from __future__ import annotations

from pathlib import Path
from random import Random

from tests.sumo_env.plans import grid, route_file

# class, and length [m] where it is not the class's own
KINDS = [("passenger", ""), ("passenger", "1"), ("passenger", "30"), ("passenger", "120"), ("motorcycle", "")]
KINDS += [("delivery", ""), ("truck", ""), ("bus", ""), ("coach", ""), ("trailer", "")]
ARRIVALS = [
    "",
    "",
    'arrivalPos="0"',
    'arrivalPos="1"',
    'arrivalPos="40"',
    'arrivalPos="-20"',
    'arrivalPos="center"',
]
ARRIVALS += ['arrivalEdge="1"', 'arrivalEdge="2" arrivalPos="30"']
REROUTED = "<interval begin='0' end='9999'>{}</interval>"
# what stands beside the road, on one edge
BESIDE = [
    "",
    "<rerouter id='r' edges='{edge}'>" + REROUTED.format("<closingReroute id='{other}'/>") + "</rerouter>",
    "<rerouter id='r' edges='{edge}'>" + REROUTED.format("<destProbReroute id='{other}'/>") + "</rerouter>",
    "<rerouter id='r' edges='{edge}'>"
    + REROUTED.format("<destProbReroute id='terminateRoute'/>")
    + "</rerouter>",
    "<calibrator id='c' edge='{edge}' pos='5'><flow begin='0' end='999' vehsPerHour='30' speed='9'/></calibrator>",
    "<vaporizer id='{edge}' begin='0' end='9999'/>",
]


def drawn(folder: Path, rng: Random) -> tuple[Path, Path, Path]:
    """A network, its routes, and what stands beside them; the ego is the vehicle "ego", of the type "own"."""
    length, lanes = rng.choice([60, 90, 140]), rng.choice([1, 2])
    options = ["--grid.number=3", f"--grid.length={length}", f"-L={lanes}", "--no-turnarounds"]
    net = grid(folder, *options, *(["--tls.guess"] if rng.random() < 0.5 else []))
    nodes = [f"{column}{row}" for column in "ABC" for row in "012"]
    edges = [a + b for a in nodes for b in nodes if _next(a, b)]

    def trip(name: str, kind: str, depart: float, further: str = "") -> str:
        start, end = rng.sample(edges, 2)
        return f'<trip id="{name}" type="{kind}" depart="{depart}" from="{start}" to="{end}" {further}/>'

    types = ""
    for name, chosen in [("own", rng.choice(KINDS)), *((f"k{n}", kind) for n, kind in enumerate(KINDS))]:
        size = f'length="{chosen[1]}"' if chosen[1] else ""
        types += f'<vType id="{name}" vClass="{chosen[0]}" {size}/>'
    count = rng.choice([5, 25, 60])
    trips = [trip(f"t{n}", f"k{rng.randrange(len(KINDS))}", 2.0 * n) for n in range(count)]
    trips.insert(5, trip("ego", "own", 9.0, rng.choice(ARRIVALS)))
    beside = rng.choice(BESIDE)
    edge, other = rng.sample(edges, 2)
    additional = folder / "beside.add.xml"
    additional.write_text(f"<additional>{beside.format(edge=edge, other=other)}</additional>")
    return net, route_file(folder, types + "".join(trips)), additional


def _next(one: str, other: str) -> bool:
    return abs(ord(one[0]) - ord(other[0])) + abs(int(one[1]) - int(other[1])) == 1
