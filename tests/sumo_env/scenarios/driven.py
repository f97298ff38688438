"""Random scenarios in SUMO's own files.

KINDS: on which outlines touch where SUMO sees no collision. `drawn`: vehicles of 1 to 120 m, ways that end anywhere,
and what changes or ends them.
"""

from pathlib import Path
from random import Random

from tests.sumo_env.plans import build, grid, route_file, streets

TYPES = """
    <vType id="car" carFollowModel="IDM" probability="3"/>
    <vType id="keen" lcSpeedGain="5" lcKeepRight="2" maxSpeedLat="1.5" probability="2"/>
    <vType id="bus" vClass="bus" probability="1"/>
    <vType id="lorry" vClass="truck" probability="1"/>
    <vType id="moped" vClass="moped" latAlignment="arbitrary" probability="2"/>
"""
LANES = "best", "random", "free"


def _routes(folder: Path, ways: list[str], rng: Random, ego: str) -> Path:
    """Mixed traffic on these ways, among which the ego departs."""
    flows = [
        f'<flow id="f{number}" type="mix" begin="0" end="200" probability="{rng.uniform(0.15, 0.5):.2f}" '
        f'departLane="{rng.choice(LANES)}" {way}/>'
        for number, way in enumerate(ways)
    ]
    start = f'<trip id="ego" type="keen" depart="{rng.randint(30, 80)}" departLane="best" {ego}/>'
    mix = f'<vTypeDistribution id="mix">{TYPES}</vTypeDistribution>'
    return route_file(folder, mix + "".join(flows) + start)


def _between(start: str, end: str) -> str:
    return f'from="{start}" to="{end}"'


def sublanes(folder: Path, rng: Random) -> tuple[Path, Path, list[str]]:
    """Streets with two or three lanes, on which vehicles drive beside the middle of their lanes."""
    size = "--grid.number=3", "--grid.length=120", f"-L={rng.randint(2, 3)}"
    net = grid(folder, *size, "--no-turnarounds", "--tls.guess")
    pairs = ("A0A1", "C2C1"), ("C2C1", "A0A1"), ("B0B1", "B1A1"), ("A1B1", "B1B2")
    ways = [_between(*pair) for pair in pairs]
    routes = _routes(folder, ways, rng, ways[0])
    return net, routes, ["--lateral-resolution", f"{rng.choice([0.4, 0.8, 3.2])}"]


def bus_lanes(folder: Path, rng: Random) -> tuple[Path, Path, list[str]]:
    """Lanes of one edge that are drawn elsewhere along the road: SUMO's metres of one are not beside the other's."""
    edges, nodes = "", '<node id="n0" x="0" y="0"/>'
    for k in range(4):
        x, ahead = 150 * k, rng.uniform(3.0, 8.0) * rng.choice([-1, 1])
        nodes += f'<node id="n{k + 1}" x="{x + 150}" y="0"/>'
        lane = f'<lane index="0" shape="{x + 10 + ahead:.1f},-8 {x + 140 + ahead:.1f},-8"/>'
        closed = '<lane index="2" allow="bus"/>' if k % 2 else ""
        edges += f'<edge id="e{k}" from="n{k}" to="n{k + 1}" numLanes="3" speed="14">{lane}{closed}</edge>'
    net = build(folder, (nodes, edges), "--no-turnarounds")
    way = _between("e0", "e3")
    stops = "".join(
        f'<vehicle id="s{k}" type="{kind}" depart="{2 * k}" departLane="{k % 2}"><route edges="e0 e1 e2 e3"/>'
        f'<stop lane="e{1 + k % 3}_{k % 2}" endPos="{rng.uniform(20, 120):.1f}" duration="25"/></vehicle>'
        for k, kind in enumerate(rng.choices(["car", "bus"], k=12))
    )
    routes = _routes(folder, [way, way], rng, way)
    routes.write_text(routes.read_text().replace("<trip", stops + "<trip"))
    return net, routes, []


def junctions(folder: Path, rng: Random) -> tuple[Path, Path, list[str]]:
    """A large junction in which SUMO lets the turns to the left of both directions pass through each other."""
    ends = {"n": (0, 200), "s": (0, -200), "e": (200, 0), "w": (-200, 0)}
    kind = rng.choice(["unregulated", "traffic_light"])
    nodes = f'<node id="c" x="0" y="0" radius="25" type="{kind}"/>'
    nodes += "".join(f'<node id="{name}" x="{x}" y="{y}"/>' for name, (x, y) in ends.items())
    edges = streets(*(way for name in ends for way in (f"{name}c", f"c{name}")), lanes=2)
    net = build(folder, (nodes, edges), "--no-turnarounds")
    ways = [_between(f"{a}c", f"c{b}") for a, b in ("wn", "es", "we", "ns")]
    return net, _routes(folder, ways, rng, ways[0]), []


# Roads over each other: contacts/test_meeting.py.
KINDS = (sublanes, bus_lanes, junctions)


# class, and length [m] where it is not the class's own
CLASSES = [
    ("passenger", ""),
    ("passenger", "1"),
    ("passenger", "30"),
    ("passenger", "120"),
    ("motorcycle", ""),
]
CLASSES += [("delivery", ""), ("truck", ""), ("bus", ""), ("coach", ""), ("trailer", "")]
ARRIVALS = ["", "", *(f'arrivalPos="{place}"' for place in ("0", "1", "40", "-20", "center"))]
ARRIVALS += ['arrivalEdge="1"', 'arrivalEdge="2" arrivalPos="30"']
REROUTER = "<rerouter id='r' edges='{{edge}}'><interval begin='0' end='9999'><{}/></interval></rerouter>"
# what stands beside the road, on one edge
BESIDE = [
    "",
    REROUTER.format("closingReroute id='{other}'"),
    REROUTER.format("destProbReroute id='{other}'"),
    REROUTER.format("destProbReroute id='terminateRoute'"),
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
    for name, chosen in [("own", rng.choice(CLASSES)), *((f"k{n}", kind) for n, kind in enumerate(CLASSES))]:
        size = f'length="{chosen[1]}"' if chosen[1] else ""
        types += f'<vType id="{name}" vClass="{chosen[0]}" {size}/>'
    count = rng.choice([5, 25, 60])
    trips = [trip(f"t{n}", f"k{rng.randrange(len(CLASSES))}", 2.0 * n) for n in range(count)]
    trips.insert(5, trip("ego", "own", 9.0, rng.choice(ARRIVALS)))
    beside = rng.choice(BESIDE)
    edge, other = rng.sample(edges, 2)
    additional = folder / "beside.add.xml"
    additional.write_text(f"<additional>{beside.format(edge=edge, other=other)}</additional>")
    return net, route_file(folder, types + "".join(trips)), additional


def _next(one: str, other: str) -> bool:
    return abs(ord(one[0]) - ord(other[0])) + abs(int(one[1]) - int(other[1])) == 1
