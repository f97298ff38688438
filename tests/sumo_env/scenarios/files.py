"""Five small scenarios in SUMO's own files, of the kinds that public ones are made of."""

from pathlib import Path

from tests.sumo_env.plans import grid

GRID = ["--grid.number=3", "--grid.length=150", "-L=2", "--no-turnarounds", "--seed=1", "--tls.guess=true"]
TRIPS = """
    <flow id="east" begin="0" end="300" period="6" from="A0A1" to="C2C1"/>
    <flow id="west" begin="0" end="300" probability="0.15" from="C0C1" to="A2A1"/>
    <trip id="ego" depart="5" from="A0A1" to="C1C2"/>
"""
SCENARIOS = {
    # traffic lights of one cycle; trips that SUMO routes, of its default driver (Krauss with sigma .5)
    "static": (["--tls.set=B1,A1"], TRIPS, ""),
    # lights that look at the traffic; drivers that overlook things
    "actuated": (
        ["--tls.set=B1", "--tls.default-type=actuated"],
        '<vType id="eidm" carFollowModel="EIDM"/><vType id="lorry" vClass="truck"/>'
        '<flow id="north" begin="0" end="300" probability="0.3" type="eidm" from="B0B1" to="B1B2"/>'
        '<flow id="truck" begin="0" end="300" period="exp(0.1)" type="lorry" from="A1B1" to="B1C1"/>' + TRIPS,
        "",
    ),
    # types and routes by distribution; taxis, people on foot and a bus that stops
    "people": (
        ["--sidewalks.guess=true", "--crossings.guess=true"],
        '<vType id="cab" vClass="taxi"><param key="has.taxi.device" value="true"/></vType>'
        '<vTypeDistribution id="mix"><vType id="quick" probability="2" speedFactor="normc(1.1,0.1)"/>'
        '<vType id="slow" probability="1" maxSpeed="9"/><vType id="bike" vClass="bicycle" probability="1"/>'
        "</vTypeDistribution>"
        '<flow id="mixed" begin="0" end="300" type="mix" probability="0.3" from="A0A1" to="C2C1"/>'
        '<vehicle id="cab0" type="cab" depart="1"><route edges="A1B1 B1C1"/></vehicle>'
        '<vehicle id="bus" depart="2"><route edges="A0A1 A1B1 B1C1 C1C2"/><stop edge="A1B1" duration="15"/></vehicle>'
        '<person id="walker" depart="3"><walk from="A1B1" to="B1C1"/></person>'
        '<person id="rider" depart="6"><ride from="B1C1" to="C1C2" lines="taxi"/></person>'
        '<trip id="ego" depart="8" from="A0A1" to="C1C2"/>',
        "",
    ),
    # a calibrator that adds and removes vehicles, a rerouter that closes a street, induction loops
    "additional": (
        [],
        TRIPS,
        '<calibrator id="c" edge="B0B1" pos="20" freq="30"><route id="up" edges="B0B1 B1B2"/>'
        '<flow begin="0" end="300" route="up" vehsPerHour="900" speed="9"/></calibrator>'
        '<rerouter id="r" edges="A0A1"><interval begin="20" end="200"><closingReroute id="A1B1"/></interval></rerouter>'
        '<inductionLoop id="loop" lane="B1B2_0" pos="50" period="60" file="NUL"/>',
    ),
    # drivers of their own, queues at the entrance, speeds and lanes that SUMO chooses
    "queues": (
        [],
        '<vType id="idm" carFollowModel="IDM" tau="1.4" lcAssertive="2" speedDev="0.2"/>'
        + "".join(f'<trip id="q{k}" type="idm" depart="1" from="A0A1" to="B2C2"/>' for k in range(15))
        + '<trip id="ego" depart="4" from="A0A1" to="C1C2" departSpeed="max" departLane="free"/>'
        '<flow id="late" begin="30" end="300" number="40" type="idm" from="C0C1" to="A2A1" departLane="random"/>',
        "",
    ),
}


def written(folder: Path, name: str) -> Path:
    """The configuration of one of the scenarios, in a folder that is made."""
    options, routes, additional = SCENARIOS[name]
    folder.mkdir(parents=True, exist_ok=True)
    grid(folder, *GRID, *options)
    (folder / "t.rou.xml").write_text(f"<routes>{routes}</routes>")
    (folder / "t.add.xml").write_text(f"<additional>{additional}</additional>")
    config = folder / "t.sumocfg"
    config.write_text(
        '<configuration><input><net-file value="grid.net.xml"/><route-files value="t.rou.xml"/>'
        '<additional-files value="t.add.xml"/></input><time><end value="60"/></time>'
        '<output><tripinfo-output value="trips.xml"/></output><report><log value="log.txt"/></report></configuration>'
    )
    return config
