"""Build SUMO's networks: `python -m sumo_env.networks.build` rewrites them; a test compares their bytes.

For each plan in `sumo_env.networks.plans`, writes the plain XML and runs netconvert on it (of the `eclipse-sumo` wheel,
which only this module needs). In the result, all lane speeds of a road with one limit are overwritten, also inside
junctions: netconvert limits bends to 8-10 m/s by a comfort rule, while highway-env's vehicles take them at any speed.
The header, which contains a date and paths of the machine, is dropped, so that building twice gives the same bytes.
"""

import re
import subprocess
from pathlib import Path

import sumolib

from sumo_env.networks import plans

HERE = Path(__file__).resolve().parent
OPTIONS = (
    "--offset.disable-normalization=true",  # x stays highway-env's x, y its -y
    "--no-turnarounds=true",
    "--roundabouts.guess=false",  # the ring is named in the plan
    "--junctions.join=false",
    "--precision=4",
)


def build(plan: plans.Plan, folder: Path) -> Path:
    """Write the plain XML and the network of `plan` below `folder`; returns the path of the network.

    Raises RuntimeError with netconvert's own words when it fails or warns: a warning means that the network
    deviates from the plan.
    """
    nodes, edges, connections = plan.write(folder)
    net = folder / f"{plan.name}.net.xml"
    netconvert = sumolib.checkBinary("netconvert")
    command = [netconvert, "-n", nodes, "-e", edges, "-x", connections, "-o", net, *OPTIONS]
    done = subprocess.run([str(part) for part in command], capture_output=True, text=True)
    if done.returncode or "Warning" in done.stderr:
        raise RuntimeError(f"netconvert on {plan.name}: {done.stderr.strip() or done.stdout.strip()}")
    text = re.sub(r"<!--.*?-->\s*", "", net.read_text(encoding="utf-8"), count=1, flags=re.DOTALL)
    limits = {lane.speed_limit for lane in plan.road.lanes.values()}
    if len(limits) == 1:  # on every lane, internal ones included; else the plan says them lane by lane
        text = re.sub(r'(<lane [^>]*\bspeed=")[^"]*', rf"\g<1>{limits.pop():.4f}", text)
    net.write_text(text, encoding="utf-8")
    return net


if __name__ == "__main__":
    for plan in plans.all_plans():
        print(build(plan, HERE).relative_to(HERE))
