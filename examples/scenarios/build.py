"""Builds the networks of these examples with netconvert and netgenerate (pip install eclipse-sumo).

python examples/scenarios/build.py
"""

import subprocess
import tempfile
from math import cos, pi, sin
from pathlib import Path
from xml.etree import ElementTree

import sumolib

FOLDER = Path(__file__).parent / "networks"
FIELDS = {
    "node": "id x y type",
    "edge": "id from to numLanes speed shape",
    "connection": "from fromLane to toLane",
}
RADIUS, ARM = 20.0, 120.0  # [m] of the roundabout


def circle(start, end, radius, points=9):
    """Points of an arc [m], anticlockwise; angles in quarter turns."""
    angles = [(start + (end - start) * k / (points - 1)) * pi / 2 for k in range(points)]
    return " ".join(f"{radius * cos(a):.2f},{radius * sin(a):.2f}" for a in angles)


# Elements by the fields above: one line each.
PLANS = {
    "highway": {"node": "a 0 0\nb 200 0\nc 1700 0", "edge": "in a b 3 33\nroad b c 3 33"},
    "ramp": {
        "node": "west -300 0\nsouth -250 -100\non 0 0\noff 250 0 zipper\neast 650 0",
        "edge": "main west on 2 25\nramp south on 1 20\nmerge on off 3 25\nout off east 2 25",
        "connection": "main 0 merge 1\nmain 1 merge 2\nramp 0 merge 0\nmerge 1 out 0\nmerge 2 out 1",
    },
    "left_turn": {
        "node": "c 0 0 priority\ns 0 -150\nn 0 150\nw -150 0\ne 150 0",
        "edge": "sc s c 1 14\nnc n c 1 14\nwc w c 1 14\nec e c 1 14\ncs c s 1 14\ncn c n 1 14\ncw c w 1 14\n"
        "ce c e 1 14",
    },
    "roundabout": {
        "node": "\n".join(
            f"r{k} {RADIUS * cos(k * pi / 2):.2f} {RADIUS * sin(k * pi / 2):.2f}\n"
            f"o{k} {ARM * cos(k * pi / 2):.2f} {ARM * sin(k * pi / 2):.2f}"
            for k in range(4)
        ),
        "edge": "\n".join(
            f"in{k} o{k} r{k} 1 14\nout{k} r{k} o{k} 1 14\n"
            f"ring{k} r{k} r{(k + 1) % 4} 1 8 {circle(k, k + 1, RADIUS).replace(' ', ';')}"
            for k in range(4)
        ),
    },
    "lights": {
        "node": "west -300 0\neast 1100 0\n"
        + "\n".join(
            f"l{k} {250 * k} 0 traffic_light\nn{k} {250 * k} 120\ns{k} {250 * k} -120" for k in range(4)
        ),
        "edge": "in west l0 1 14\n"
        + "\n".join(f"m{k} l{k} {f'l{k + 1}' if k < 3 else 'east'} 1 14" for k in range(4))
        + "\n"
        + "\n".join(f"down{k} n{k} l{k} 1 14\nleave{k} l{k} s{k} 1 14" for k in range(4)),
    },
    "platoon": {"node": "a 0 0\nb 1200 0", "edge": "road a b 1 20"},
    "ring": {
        "node": "\n".join(
            f"q{k} {36.6 * cos(k * pi / 2):.2f} {36.6 * sin(k * pi / 2):.2f}" for k in range(4)
        ),
        "edge": "\n".join(
            f"e{k} q{k} q{(k + 1) % 4} 1 15 {circle(k, k + 1, 36.6).replace(' ', ';')}" for k in range(4)
        ),
    },
}
OPTIONS = {"roundabout": ["--roundabouts.guess"], "lights": ["--tls.cycle.time=60"]}
TOWN = "--rand --rand.iterations=25 --rand.min-distance=70 --rand.max-distance=150 --seed=4 --tls.guess"


def build(name, plan):
    """Write the network of a plan."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sumolib.checkBinary("netconvert"), *OPTIONS.get(name, []), "--no-turnarounds"]
        for kind, lines in plan.items():
            root = ElementTree.Element(f"{kind}s")
            for line in lines.split("\n"):
                values = [value.replace(";", " ") for value in line.split()]
                ElementTree.SubElement(root, kind, dict(zip(FIELDS[kind].split(), values, strict=False)))
            ElementTree.ElementTree(root).write(f"{folder}/{kind}")
            command.append(f"--{kind}-files={folder}/{kind}")
        run(name, command)


def run(name, command):
    """Run a command that writes a network, without the time at which it did."""
    net = FOLDER / f"{name}.net.xml"
    subprocess.run([*command, f"--output-file={net}", "--write-license=false"], check=True)
    text = net.read_text()
    end = text.index("-->") + 3
    net.write_text(text[: text.index("<!--")] + text[end:].lstrip())


if __name__ == "__main__":
    for name, plan in PLANS.items():
        build(name, plan)
    run("town", [sumolib.checkBinary("netgenerate"), *TOWN.split(), "--no-turnarounds"])
