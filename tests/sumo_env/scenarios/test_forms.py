"""Forms of configurations and files that people have: each drives as ``sumo`` does, or better where ``sumo`` fails."""

import gzip
import re
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import pytest

from sumo_env.scenarios import SumoDrivingEnv
from sumo_env.simulator import SimulatorError
from tests.processes import python
from tests.sumo_env.plans import Rows, build, grid, needs_sumo
from tests.sumo_env.rollout import drive
from tests.sumo_env.scenarios import test_oracle
from tests.sumo_env.scenarios.test_oracle import differences, driven

pytestmark = [needs_sumo, pytest.mark.filterwarnings("ignore")]
SECONDS = 12
SECOND = {"simulation_frequency": 1, "duration": 99}
WAY = 'from="A0A1" to="B1B0"'
PLACE = 'lane="A1B1_0" startPos="20" endPos="60"'
EGO = f'<trip id="ego" depart="0" {WAY}/>'
ROUTES = f'{EGO}<flow id="f" begin="0" end="99" probability="0.4" {WAY}/>'
ADDITIONAL = '<vType id="DEFAULT_VEHTYPE" tau="1.3"/>'
TEXT = """<{root}>
<input><net-file value="{net}"/><route-files value="{routes}"/><additional-files value="{additional}"/></input>
<time><step-length value="1"/></time>{more}
</{root}>"""
FILES = {"net": "n.net.xml", "routes": "r.rou.xml", "additional": "a.add.xml"}
USUAL = {**FILES, "root": "configuration", "more": ""}
Change = Callable[[str], str]


def says(**parts: str) -> Change:
    """The configuration with other parts of TEXT."""
    return lambda _: TEXT.format(**{**USUAL, **parts})


def option(name: str, value: object, section: str = "processing") -> Change:
    """The configuration with an option more."""
    return says(more=f'<{section}><{name} value="{value}"/></{section}>')


def without(*words: str) -> Change:
    """The configuration without these words; pairs "old => new" are replaced."""

    def change(text: str) -> str:
        for word in words:
            old, _, new = word.partition(" => ")
            assert old in text
            text = text.replace(old, new)
        return text

    return change


# What a form changes: the configuration's text, its name, names of the files ("n", "r", "a") and their contents.
CONFIGURATIONS: dict[str, Change] = {  # of the usual traffic; some of them ``sumo`` cannot drive
    "as usual": says(),
    "root of SUMO's own saving": says(root="sumoConfiguration"),
    "short attributes": without("net-file value => net-file v"),
    "text in place of an attribute": without('-file value="n.net.xml"/> => -file>n.net.xml</net-file>'),
    "synonyms": without("net-file => n", "route-files => routes", "additional-files => additional"),
    "no sections": without("<input>", "</input>", "<time>", "</time>"),
    "one section for all": without("</input>\n<time>", "</time> => </input>"),
    "a list with a space": says(routes="r.rou.xml, more.rou.xml"),
    "nothing for a value": option("weight-files", "", "input"),
    "settings of the window among the inputs": option("gui-settings-file", "nobody.xml", "input"),
    "end": option("end", "3", "time"),
    "words": option("verbose", "true", "report"),
    "a port": option("remote-port", "8813", "traci_server"),
    "a schema": option("xml-validation", "auto", "report"),
    "a prefix": option("output-prefix", "x-", "output"),
    "an output into no folder": option("summary-output", "nowhere/out.xml", "output"),
    "a time with colons": option("begin", "0:00:00", "time"),
}
TRAFFIC: dict[str, Change] = {  # that change it
    "threads": option("threads", "2"),
    "twice the traffic": option("scale", "2"),
    "half a second": without('step-length value="1 => step-length value="0.5'),
    "ballistic": option("step-method.ballistic", "true"),
    "sublanes": option("lateral-resolution", "0.8"),
    "lane changes that take time": option("lanechange.duration", "2"),
    "teleports": option("time-to-teleport", "3"),
    "no lanes inside": option("no-internal-links", "true"),
    "all routes at once": option("route-steps", "0", "input"),
    "rerouting": option("device.rerouting.probability", "1", "routing"),
}
NAMES: dict[str, tuple[dict[str, str], Change]] = {  # other names of files, the configuration's own is "c"
    "a space as %20": ({"n": "a b.net.xml"}, says(net="a%20b.net.xml")),
    "a comma as %2C": ({"n": "a,b.net.xml"}, says(net="a%2Cb.net.xml")),
    "a variable": ({"n": "grid.net.xml"}, says(net="${SUMO_ENV_NAME}.net.xml")),
    "a home": ({"n": "home/n.net.xml"}, says(net="~/n.net.xml")),
    "no known ending": ({"n": "town.net", "r": "town.demand"}, says(net="town.net", routes="town.demand")),
    "no ending": ({"c": "town"}, says()),
    "all in a folder": (
        {"c": "x, ${HOME}%20ü/c.sumocfg"},
        says(net="../n.net.xml", routes="../r.rou.xml", additional="../a.add.xml"),
    ),
}
# Of routes ("r") and additional files ("a"); further ones are in files.py.
CONTENTS: dict[str, dict[str, str]] = {
    "an end of days": {"r": ROUTES.replace('end="99"', 'end="1:00:00:00"')},
    "no limit to gains": {"a": '<vType id="DEFAULT_VEHTYPE" lcSpeedGain="inf" lcStrategic="1e10"/>'},
    "a class of nobody": {"r": f'<vType id="t" vClass="unknown"/><vType id="u" vClass=""/>{ROUTES}'},
    "lines that are not sorted": {
        "r": f'<flow id="a" line="1" begin="6" end="60" period="30" from="A0A1" to="A1B1"/>'
        f'<flow id="b" line="2" begin="2" end="60" period="30" from="A0A1" to="A1B1"/>{EGO}'
    },
    "trips that are not sorted": {
        "r": f'{EGO}<trip id="late" depart="5" from="A0A1" to="B1B0"/>{ROUTES.replace("ego", "e")}'
    },
    "no file of what is included": {"r": f'{ROUTES}<include href="nobody.xml"/>'},
    "a bus stop and a parking area": {
        "a": f'<busStop id="s" {PLACE}/><parkingArea id="p" {PLACE} roadsideCapacity="3"/>',
        "r": f'{EGO}<vehicle id="v" depart="0"><route edges="A0A1 A1B1 B1B0"/><stop busStop="s" duration="3"/>'
        '</vehicle><vehicle id="w" depart="1"><route edges="A0A1 A1B1 B1B0"/><stop parkingArea="p" duration="9"/>'
        "</vehicle>",
    },
    "districts": {
        "a": '<taz id="y"><tazSource id="A0A1" weight="1"/></taz><taz id="z"><tazSink id="B1B0" weight="1"/></taz>',
        "r": f'{EGO}<flow id="g" begin="0" end="60" period="2" fromTaz="y" toTaz="z"/>',
    },
}


@pytest.fixture(scope="module")
def net(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return grid(tmp_path_factory.mktemp("net"), "--grid.number=2", "--grid.length=100", "-L=2")


def written(folder: Path, net: Path, text: str, names: dict[str, str], contents: dict[str, str]) -> Path:
    """The configuration of a form, with its files beside it."""
    names = {"c": "c.sumocfg", "n": "n.net.xml", "r": "r.rou.xml", "a": "a.add.xml", **names}
    routes = f"<routes>{contents.get('r', ROUTES)}</routes>"
    additional = f"<additional>{contents.get('a', ADDITIONAL)}</additional>"
    parts = {"c": text, "n": net.read_text(), "r": routes, "a": additional}
    (folder / "more.rou.xml").write_text("<routes/>")
    for part, name in names.items():
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text(parts[part])
    return folder / names["c"]


def plain(config: Path) -> Rows:
    """What ``sumo`` does with a configuration."""
    return test_oracle.plain(f"sumo -c '{config}' --seed=7 --random=false", config.parent, SECONDS)


@pytest.fixture(scope="module")
def usual(net: Path, tmp_path_factory: pytest.TempPathFactory) -> Rows:
    """What ``sumo`` does with the usual configuration."""
    return plain(written(tmp_path_factory.mktemp("usual"), net, says()(""), {}, {}))


def assert_drives(config: Path, rows: Rows) -> None:
    """That every vehicle is where ``sumo`` has it."""
    with closing(SumoDrivingEnv(config, ego_vehicle="ego", config={"duration": 99})) as env:
        env.reset(seed=7)
        scenes = driven(env, SECONDS)
        step = 1.0 / env.config["simulation_frequency"]
    assert len(scenes) > 8 and differences(scenes, rows, step) == []


@pytest.mark.parametrize("name", [*CONFIGURATIONS, *NAMES])
def test_forms_of_the_usual(name: str, net: Path, usual: Rows, tmp_path: Path, monkeypatch) -> None:
    """One of them, with a comma and a variable in the name of its folder, ``sumo`` cannot open."""
    monkeypatch.setenv("SUMO_ENV_NAME", "grid")
    monkeypatch.setenv("HOME", str(tmp_path / "in" / "home"))
    names, change = NAMES.get(name) or ({}, CONFIGURATIONS[name])
    (tmp_path / "in").mkdir()
    assert_drives(written(tmp_path / "in", net, change(says()("")), names, {}), usual)


@pytest.mark.parametrize("name", [*TRAFFIC, *CONTENTS])
def test_options_and_contents(name: str, net: Path, tmp_path: Path) -> None:
    text = TRAFFIC.get(name, says())(says()(""))
    config = written(tmp_path, net, text, {}, CONTENTS.get(name, {}))
    assert_drives(config, plain(config))


@pytest.mark.parametrize("encoding", ["latin-1", "utf-8-sig", "utf-16"])
def test_encodings(encoding: str, net: Path, usual: Rows, tmp_path: Path) -> None:
    config = written(tmp_path, net, says()(""), {"r": "grün.rou.xml"}, {})
    declared = f'<?xml version="1.0" encoding="{encoding.removesuffix("-sig")}"?>'
    config.write_text(declared + says(routes="grün.rou.xml")(""), encoding=encoding)
    assert_drives(config, usual)


def test_a_network_of_sumo_1_22(net: Path, usual: Rows, tmp_path: Path) -> None:
    """netconvert wrote the number 0 for two lanes within a junction."""
    text = net.read_text()
    number = re.search(r'id=":[AB][01]_\d_1" index="1"', text)
    assert number is not None
    old = tmp_path / "old.net.xml"
    old.write_text(text.replace(number[0], number[0].replace('index="1"', 'index="0"')))
    assert_drives(written(tmp_path, old, says()(""), {}, {}), usual)


def test_packed_files(net: Path, usual: Rows, tmp_path: Path) -> None:
    text = says(net="n.net.xml.gz", routes="r.rou.xml.gz")("")
    config = written(tmp_path, net, text, {}, {})
    for name in ("n.net.xml", "r.rou.xml"):
        (tmp_path / f"{name}.gz").write_bytes(gzip.compress((tmp_path / name).read_bytes()))
        (tmp_path / name).unlink()
    assert_drives(config, usual)


def test_a_train_on_rails_alone(tmp_path: Path) -> None:
    """SUMO drives it; an agent may as well."""
    rails = '<edge id="{0}{1}" from="{0}" to="{1}" numLanes="1" speed="20" allow="rail"/>'
    edges = rails.format(*"ab") + rails.format(*"bc")
    net = build(tmp_path, ("a 0 0, b 300 0, c 600 50", f"<edges>{edges}</edges>"))
    train = '<vType id="train" vClass="rail"/><trip id="{}" type="train" depart="{}" from="ab" to="bc"/>'
    text = says(net=net.name)("")
    config = written(tmp_path, net, text, {"n": net.name}, {"r": train.format("ego", 0)})
    assert_drives(config, plain(config))
    for origin in ({"ego_vehicle": "ego"}, {"ego_route": ["ab", "bc"], "ego_type": "train"}):
        env = SumoDrivingEnv(config, **origin, config={"duration": 99})
        *_, (*_, info) = drive(env, 3, seed=0)
        env.close()
        assert info["rewards"]["arrived_reward"] == 1.0
    road = '<edge id="ca" from="c" to="a" numLanes="1" speed="20" allow="passenger"/>'
    both = build(tmp_path, ("a 0 0, b 300 0, c 600 50", f"<edges>{edges}{road}</edges>"))
    with (
        closing(SumoDrivingEnv(both, tmp_path / "r.rou.xml", ego_vehicle="ego")) as env,
        pytest.raises(SimulatorError, match=r"ego.*rail.*no lane for cars"),
    ):
        env.reset(seed=0)


ODD = """
import os, sys
os.chdir(sys.argv[1])
os.rmdir(sys.argv[1])
from sumo_env.scenarios import SumoDrivingEnv
for _ in range(2):  # the second one is in a worker
    env = SumoDrivingEnv(os.fsdecode(sys.argv[2].encode("utf-8", "surrogateescape")), ego_vehicle="ego")
    env.reset(seed=7)
    print(env.step(1)[0].ravel()[:5])
"""


def test_odd_places(net: Path, tmp_path: Path) -> None:
    """A deleted working folder, the locale C, temporary files in a folder with a variable in its name, -W error."""
    gone, temporary, files = (tmp_path / name for name in ("gone", "${HOME}, ü", "größe"))
    for folder in (gone, temporary, files):
        folder.mkdir()
    config = written(files, net, says(net="grün.net.xml")(""), {"n": "grün.net.xml"}, {})
    odd = {"LC_ALL": "C", "PYTHONUTF8": "0", "TMPDIR": str(temporary)}
    words = python("-W", "error::UserWarning", "-c", ODD, str(gone), str(config), **odd).splitlines()
    assert len(words) == 2 and words[0] == words[1]
    assert list(temporary.iterdir()) == []


def test_arguments_of_any_name(net: Path, usual: Rows, tmp_path, monkeypatch) -> None:
    """As they lie in the working folder, without the endings that SUMO's own files have."""
    written(tmp_path, net, says()(""), {"n": "town", "r": "demand.txt", "a": "more"}, {})
    monkeypatch.chdir(tmp_path)
    given = "town", "demand.txt"
    with closing(SumoDrivingEnv(*given, additional="more", ego_vehicle="ego", config=SECOND)) as env:
        env.reset(seed=7)
        assert differences(driven(env, SECONDS), usual, 1.0) == []


def test_a_link_to_a_configuration(net: Path, usual: Rows, tmp_path: Path) -> None:
    """SUMO looks for its files beside the link."""
    config = written(tmp_path, net, says()(""), {}, {})
    (tmp_path / "elsewhere").mkdir()
    config.rename(tmp_path / "elsewhere" / "c.sumocfg")
    config.symlink_to("elsewhere/c.sumocfg")
    assert_drives(config, usual)
