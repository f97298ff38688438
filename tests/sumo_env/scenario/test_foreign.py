"""Files of SUMO that somebody else wrote: they write nothing, open no connection, end no process and do not hang."""

from __future__ import annotations

import gzip
import os
import re
import socket
import warnings
from pathlib import Path
from typing import Any

import pytest

from sumo_env.config import ConfigError
from sumo_env.env import SumoDrivingEnv
from sumo_env.traffic import foreign
from sumo_env.traffic.foreign import check_files
from sumo_env.traffic.sumo_files import configuration
from tests.sumo_env.plans import needs_sumo
from tests.sumo_env.scenario.files import written

LAUGHS = "<!DOCTYPE x [<!ENTITY a 'ha'>" + "".join(f"<!ENTITY l{n} '&a;&a;'>" for n in range(9)) + "]>"
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


@pytest.mark.parametrize("tag", [tag for tag in WRITERS if tag != "vType"])
def test_a_network_has_no_detectors(tag: str, town: Path, tmp_path: Path) -> None:
    network = (town / "grid.net.xml").read_text()
    element = WRITERS[tag].format(tmp_path / "out.xml")
    said = refused(network.replace("</net>", f"{element}</net>"), tmp_path, ".net.xml")
    assert re.search(rf", line \d+: <{tag}> in a network may end the process: move it", said)


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


def test_outputs_of_a_configuration_do_not_connect(town: Path, tmp_path: Path) -> None:
    config = town / "connects.sumocfg"
    config.write_text((town / "t.sumocfg").read_text().replace("trips.xml", "localhost:8000"))
    with pytest.raises(ConfigError, match="tripinfo-output='localhost:8000' opens a connection"):
        SumoDrivingEnv(config, ego_vehicle="ego", output_dir=tmp_path)


def changed(town: Path, options: str) -> Path:
    """The configuration of a town with further options."""
    config = town / "odd.sumocfg"
    config.write_text((town / "t.sumocfg").read_text().replace("<time>", f"<time>{options}"))
    return config


def test_outputs_of_a_configuration_go_to_the_folder_alone(town: Path, tmp_path: Path) -> None:
    """SUMO writes a file of this output for each step where the option says, whatever the prefix of outputs is."""
    config = changed(town, f'<vtk-output value="{tmp_path}/precious"/>')
    with pytest.raises(ConfigError, match=r"vtk-output='.*precious' is not written to output_dir"):
        SumoDrivingEnv(config, ego_vehicle="ego", output_dir=tmp_path / "out")


@pytest.mark.parametrize("option", ["astar.landmark-distances", "device.ssm.filter-edges.input-file"])
def test_a_device_is_not_read_for_any_option(option: str, town: Path) -> None:
    config = changed(town, f'<{option} value="/dev/zero"/>')
    with pytest.raises(ConfigError, match=rf"{option}='/dev/zero' is no regular file"):
        SumoDrivingEnv(config, ego_vehicle="ego")


def test_an_option_of_two_values_is_refused(town: Path) -> None:
    config = changed(town, '<n value="grid.net.xml"/><begin value="3"/><b value="5"/>')
    with pytest.raises(ConfigError, match=r"odd\.sumocfg: the option 'begin' is given twice: '3' and '5'"):
        SumoDrivingEnv(config, ego_vehicle="ego")


def test_a_configuration_neither_ends_sumo_nor_lets_it_read_schemas(town: Path) -> None:
    names = ("xml-validation", "X", "xml-validation.routes", "save-template", "C", "version", "c", "tripinfo")
    more = "".join(f'<{name} value="{"trips.xml" if name == "tripinfo" else "auto"}"/>' for name in names)
    assert set(configuration(changed(town, more))) == {
        *("net-file", "route-files", "additional-files", "tripinfo-output", "log")
    }


@needs_sumo
def test_sumo_reads_no_schema_of_the_network(town: Path, tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        where = f"http://127.0.0.1:{server.getsockname()[1]}/a.xsd"
        routes = tmp_path / "r.rou.xml"
        routes.write_text(
            f'<routes xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance" xsi:noNamespaceSchemaLocation="{where}"/>'
        )
        config = town / "schema.sumocfg"
        text = (town / "t.sumocfg").read_text().replace("t.rou.xml", str(routes))
        config.write_text(text.replace("<time>", '<time><xml-validation value="auto"/>'))
        env = SumoDrivingEnv(config, ego_route=["A0A1", "A1B1"])
        env.reset(seed=0)
        env.close()
        server.setblocking(False)
        with pytest.raises(BlockingIOError):
            server.accept()


@pytest.mark.parametrize("ending", [".net.xml", ".rou.xml", ".add.xml", ".rou.xml.gz"])
def test_document_types_are_refused(ending: str, tmp_path: Path) -> None:
    said = refused(f"{LAUGHS}<routes/>", tmp_path, ending)
    assert ", line 1: a document type" in said
    text = f'<?xml version="1.0" encoding="utf-16"?>{LAUGHS}<routes/>'
    (tmp_path / "a.rou.xml").write_bytes(text.encode("utf-16"))
    with pytest.raises(ConfigError, match="a document type"):
        check_files({"route-files": str(tmp_path / "a.rou.xml")})


NUMBERS = ["nan", "NaN", "inf", "-Infinity", "1e308", "-1e99", "1e10", "12345678901", "0x1p200"]


@pytest.mark.parametrize("number", NUMBERS)
@pytest.mark.parametrize(
    "name", ["depart", "departPos", "departSpeed", "accel", "maxSpeed", "speedFactor", "shape"]
)
def test_numbers_are_numbers(name: str, number: str, tmp_path: Path) -> None:
    for text in (number, f"normc(1,{number})", f"1,2 {number},3"):
        said = refused(f'<routes>\n<vehicle id="inf" {name}="{text}"/></routes>', tmp_path)
        assert f'line 2: <vehicle {name}="{text}"> is no number that SUMO can drive with' in said


def test_words_and_long_numbers_are_allowed(tmp_path: Path) -> None:
    file = tmp_path / "a.rou.xml"
    file.write_text(
        '<routes><vType id="nan" accel="2.123456789012345" speedFactor="normc(1,0.1,0.2,2)" height="1e-12"/>'
        '<vehicle id="1e308" depart="triggered" departPos="random_free" departSpeed="speedLimit" line="infinity"/>'
        '<flow id="inf" begin="1:00:00" end="999999999" vehsPerHour="1800" departLane="best"/></routes>'
    )
    check_files({"route-files": str(file)})


@pytest.mark.parametrize(
    "element",
    [
        'edge id="b"><lane id="a" index="0" shape="0,0 9,0" width="0"/></edge',
        'edge id="b"><lane id="a" index="0" shape="0,0 9,0" length="-1"/></edge',
        'vType id="a" length="0"',
        'vType id="a" maxSpeed="-3"',
        'vType id="a" scale="1e9"',
        'vType id="a" speedDev="1e8"',
        'vType id="a" speedFactor="normc(1,1e8)"',
        'route id="a" repeat="999999999"',
        'trip id="a" departPos="1e8"',
        'trip id="a" departPosLat="1e8"',
        'vType id="a" minGap="1e8"',
        'vType id="a" speedFactor="normc(1,"',
        'laneAreaDetector id="a" length="1e8"',
        'step time="0" speed="1e8"',
    ],
)
def test_numbers_are_possible(element: str, tmp_path: Path) -> None:
    is_network = element.endswith("edge")
    text = f"<a><{element}></a>" if is_network else f"<a><{element}/></a>"
    said = refused(text, tmp_path, ".net.xml" if is_network else ".add.xml")
    assert re.search(r"must be from \S+ to \S+", said)


@pytest.mark.parametrize(
    "lanes",
    [
        '<lane index="0" shape="0,0 9,0"/>',
        '<edge><lane index="1" shape="0,0 9,0"/></edge>',
        '<edge><lane index="0" shape="0,0 9,0"/><lane index="0" shape="0,0 9,0"/></edge>',
        '<edge><lane index="0" shape="0,0"/></edge>',
    ],
)
def test_lanes_that_would_end_the_process(lanes: str, tmp_path: Path) -> None:
    said = refused(f"<net>{lanes}</net>", tmp_path, ".net.xml")
    assert re.search(r"line 1: expected lane \d of an edge, with a shape of two points or more", said)


@pytest.mark.parametrize("encoding", ["utf-7", "shift_jis", "ufo"])
def test_an_encoding_that_is_not_known_is_named(encoding: str, town: Path, tmp_path: Path) -> None:
    refused(f"<?xml version='1.0' encoding='{encoding}'?><routes/>", tmp_path)
    config = town / "odd.sumocfg"
    config.write_text(f"<?xml version='1.0' encoding='{encoding}'?><configuration/>")
    with pytest.raises(ConfigError, match=r"odd\.sumocfg cannot be read"):
        SumoDrivingEnv(config, ego_vehicle="ego")


@pytest.mark.parametrize(
    ("old", "new"),
    [(' fromLane="0"', ' fromLane="-1"'), ("<location ", '<edge id="q" from="A0" to="A1"/><location ')],
)
def test_a_network_that_does_not_fit_itself_is_named(old: str, new: str, town: Path) -> None:
    network = town / "odd.net.xml"
    network.write_text((town / "grid.net.xml").read_text().replace(old, new))
    with pytest.raises(ConfigError, match=r"odd\.net\.xml"):
        SumoDrivingEnv(network, town / "t.rou.xml", ego_vehicle="ego")


@pytest.mark.parametrize(
    "rate",
    [
        'number="1000000000" period="0.000001"',
        'number="1000000000"',
        'begin="0" end="10" number="100000"',
        'vehsPerHour="999999999"',
        'perHour="999999999"',
        'period="exp(999999999)"',
        'period="0.001"',
    ],
)
@pytest.mark.parametrize("tag", ["flow", "personFlow"])
def test_flows_are_bounded(tag: str, rate: str, tmp_path: Path) -> None:
    said = refused(f'<routes><{tag} id="f" {rate}/></routes>', tmp_path)
    assert re.search(rf"<{tag}> 'f' asks for .* departures a second; at most 100 are possible", said)


@pytest.mark.parametrize("text", ["<net/>", "<additional><net><edge id='e'/></net></additional>"])
def test_a_network_is_no_additional_file(text: str, tmp_path: Path) -> None:
    assert "line 1: this is a network, and no file of routes" in refused(text, tmp_path, ".add.xml")


def test_nesting_is_bounded(tmp_path: Path) -> None:
    assert "more than 50 elements in each other" in refused(f"{'<a>' * 99}{'</a>' * 99}", tmp_path)


def test_what_includes_itself_is_refused(tmp_path: Path) -> None:
    one, other = tmp_path / "one.rou.xml", tmp_path / "other.rou.xml"
    one.write_text('<routes><include href="other.rou.xml"/></routes>')
    other.write_text("<routes/>")
    check_files({"route-files": str(one)})
    other.write_text('<routes><include href="one.rou.xml"/></routes>')
    with pytest.raises(ConfigError, match="would not come to an end"):
        check_files({"route-files": str(one)})
    other.write_text('<routes><include href="/dev/zero"/></routes>')
    with pytest.raises(ConfigError, match="/dev/zero is no regular file"):
        check_files({"route-files": str(one)})


@pytest.mark.parametrize("argument", ["network", "routes", "additional"])
def test_a_pipe_is_not_waited_for(argument: str, town: Path, tmp_path: Path) -> None:
    files: dict[str, Any] = {"network": town / "grid.net.xml", "routes": town / "t.rou.xml"}
    files[argument] = tmp_path / "pipe.xml"
    os.mkfifo(files[argument])
    with pytest.raises(ConfigError, match=r"there is no file .*pipe\.xml"):
        SumoDrivingEnv(**files, ego_vehicle="ego")


def test_what_is_read_has_an_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A file that unpacks to more than memory, one word of megabytes, and a crowd at one moment."""
    monkeypatch.setattr(foreign, "UNPACKED", 2**20)
    assert "GiB when it is unpacked" in refused(f"<routes>{' ' * 2**21}</routes>", tmp_path, ".rou.xml.gz")
    monkeypatch.undo()
    refused(f"<routes><!--{'x' * 10**7}--><include/></routes>", tmp_path)
    crowd = '<trip id="a" depart="2"/>' * (foreign.CROWD + 1)
    assert 'more than 10,000 vehicles have depart="2"' in refused(f"<routes>{crowd}</routes>", tmp_path)


@pytest.mark.parametrize(
    "option",
    ["step-length=0", "step-length=nan", "scale=1e9", "begin=inf", "threads=100000", "default.speeddev=1e8"],
)
def test_options_are_possible(option: str, town: Path) -> None:
    name, _, value = option.partition("=")
    config = changed(town, f'<{name} value="{value}"/>')
    with pytest.raises(ConfigError, match=rf"odd\.sumocfg: {name}='{value}' must be a number from"):
        SumoDrivingEnv(config, ego_vehicle="ego")
