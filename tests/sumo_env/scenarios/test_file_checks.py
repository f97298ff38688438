"""Files of SUMO that somebody else wrote: they write nothing, open no connection, end no process and do not hang."""

import gzip
import re
import socket
import warnings
from pathlib import Path

import pytest

from sumo_env.config import ConfigError
from sumo_env.scenarios import SumoDrivingEnv
from sumo_env.scenarios.file_checks import check_files
from tests.sumo_env.plans import needs_sumo, route_file
from tests.sumo_env.rollout import drive
from tests.sumo_env.scenarios.files import written

WRITERS = {
    "edgeData": '<edgeData id="e" period="1" file="{}"/>',
    "laneData": '<laneData id="e" period="1" file="{}"/>',
    "inductionLoop": '<inductionLoop id="e" lane="A0A1_0" pos="10" period="1" file="{}"/>',
    "e1Detector": '<e1Detector id="e" lane="A0A1_0" pos="10" period="1" file="{}"/>',
    "instantInductionLoop": '<instantInductionLoop id="e" lane="A0A1_0" pos="10" file="{}"/>',
    "e2Detector": '<e2Detector id="e" lane="A0A1_0" pos="10" length="20" period="1" file="{}"/>',
    "e3Detector": '<e3Detector id="e" period="1" file="{}"><detEntry lane="A0A1_0" pos="9"/>'
    '<detExit lane="A0A1_0" pos="50"/></e3Detector>',
    "routeProbe": '<routeProbe id="e" edge="A0A1" period="1" file="{}"/>',
    "vTypeProbe": '<vTypeProbe id="e" period="1" file="{}"/>',
    "calibrator": '<calibrator id="e" edge="A0A1" pos="20" output="{}"><flow begin="0" end="9" vehsPerHour="900" '
    'speed="9"/></calibrator>',
    "timedEvent": '<timedEvent type="SaveTLSStates" source="B1" dest="{}"/>',
    "vType": '<vType id="e"><param key="device.ssm.file" value="{}"/></vType>',
}


@pytest.fixture(scope="module")
def town(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return written(tmp_path_factory.mktemp("town"), "static").parent


def refused(content: str, folder: Path, ending: str = ".rou.xml") -> str:
    """What is said of a file with this content."""
    file = folder / f"foreign{ending}"
    file.write_bytes(gzip.compress(content.encode()) if ending.endswith("gz") else content.encode())
    with pytest.raises(ConfigError, match=re.escape(str(file))) as caught:
        check_files({"net-file" if "net" in ending else "route-files": str(file)})
    return str(caught.value)


ENDS = {  # what ends the process of SUMO 1.28: a file, its ending, a word of the error
    "statistics in a network": ('<net><edgeData id="e" period="1" file="x"/></net>', ".net.xml", "edgeData"),
    "lanes' statistics in a network": ('<net><laneData id="e" file="x"/></net>', ".net.xml", "laneData"),
    "an event in a network": (
        '<net><timedEvent type="SaveTLSStates" dest="x"/></net>',
        ".net.xml",
        "timedEvent",
    ),
    "a lane of no edge": ('<net><edge id="a"/><lane index="0"/></net>', ".net.xml", "lane of no edge"),
    "a lane twice": (
        '<net><edge id="a"><lane index="0"/><lane index="0"/></edge></net>',
        ".net.xml",
        "lane 0",
    ),
    "a network within": ('<a><net><edge id="e"/></net></a>', ".add.xml", "this is a network"),
    "include of nothing": ("<routes><include/></routes>", ".rou.xml", "include"),
    "include of itself": ('<a><include href="foreign.add.xml"/></a>', ".add.xml", "includes"),
    "no file of speeds": ('<a><variableSpeedSign id="v" file="none.xml"/></a>', ".add.xml", "none.xml"),
}


@pytest.mark.parametrize("name", ENDS)
def test_what_would_end_the_process_is_refused(name: str, tmp_path: Path) -> None:
    text, ending, word = ENDS[name]
    assert word in refused(text, tmp_path, ending)


def test_what_sumo_takes_is_taken(tmp_path: Path) -> None:
    """Numbers, words, crowds, document types, lanes within junctions of SUMO 1.22 to 1.27: SUMO judges them."""
    file = tmp_path / "a.rou.xml"
    file.write_text(
        '<!DOCTYPE routes><routes><vType id="nan" accel="nan" maxSpeed="1e10" lcSpeedGain="inf" vClass="unknown"/>'
        '<include href="nobody.xml"/><poly id="p" shape="nan,nan"/><flow id="f" begin="0" end="1e15" period="1e-5"/>'
        f'<trip id="inf" depart="triggered" departSpeed="max"/>{"<a>" * 99}{"</a>" * 99}</routes>'
    )
    assert check_files({"route-files": str(file)}).ids >= {"nan", "f", "inf"}
    net, twice = tmp_path / "a.net.xml", '<edge id=":a_0"><lane index="0"/><lane index="0"/></edge>'
    net.write_text(f'<net>{twice}<edge id="b"><lane index="1"/></edge></net>')
    check_files({"net-file": str(net)})


@pytest.mark.parametrize("tag", WRITERS)
def test_nothing_connects(tag: str, tmp_path: Path) -> None:
    for place in ("localhost:8000", "[::1]:8000"):
        assert "opens a connection" in refused(f"<a>{WRITERS[tag].format(place)}</a>", tmp_path, ".add.xml")


@needs_sumo
def test_what_an_additional_file_writes_goes_nowhere(town: Path, tmp_path: Path) -> None:
    out, file = tmp_path / "precious.xml", tmp_path / "all.add.xml"
    out.write_text("mine")
    parts = [text.replace('id="e"', f'id="{tag}"').format(out) for tag, text in WRITERS.items()]
    file.write_text(f"<additional>{''.join(parts)}</additional>")
    env = SumoDrivingEnv(town / "grid.net.xml", town / "t.rou.xml", ["A0A1", "A1B1", "B1C1"], additional=file)
    env.reset(seed=0)
    for _ in range(3):
        env.step(1)
    env.close()
    assert out.read_text() == "mine" and sorted(tmp_path.iterdir()) == [file, out]


@needs_sumo
def test_sumo_reads_no_schema_of_the_network(town: Path, tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        where = f"http://127.0.0.1:{server.getsockname()[1]}/a.xsd"
        routes, xsi = tmp_path / "r.rou.xml", "http://www.w3.org/2001/XMLSchema-instance"
        routes.write_text(f'<routes xmlns:xsi="{xsi}" xsi:noNamespaceSchemaLocation="{where}"/>')
        config = town / "schema.sumocfg"
        text = (town / "t.sumocfg").read_text().replace("t.rou.xml", str(routes))
        config.write_text(text.replace("<time>", '<time><xml-validation value="auto"/>'))
        env = SumoDrivingEnv(config, ego_route=["A0A1", "A1B1"])
        env.reset(seed=0)
        env.close()
        server.setblocking(False)
        with pytest.raises(BlockingIOError):
            server.accept()


@needs_sumo
def test_an_ego_of_an_included_file_is_known_with_the_place_where_it_arrives(town: Path, tmp_path) -> None:
    me = '<vehicle id="me" depart="1" arrivalPos="30"><route edges="A0A1 A1B1"/></vehicle>'
    more = route_file(tmp_path, me).name
    (tmp_path / "all.rou.xml").write_text(f'<routes><include href="{more}"/></routes>')
    env = SumoDrivingEnv(town / "grid.net.xml", tmp_path / "all.rou.xml", ego_vehicle="me")
    env.reset(seed=0)
    env.hand_over()
    *_, (*_, last) = list(drive(env, 1))
    assert last["ending"] == "arrived" and last["rewards"]["progress_reward"] < 0.2
