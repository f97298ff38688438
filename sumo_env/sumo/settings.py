"""What SUMO is loaded with, as a value."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

from sumo_env.networks.mapping import Network
from sumo_env.sumo.paths import listed, prefix, written
from sumo_env.sumo.user_options import OUTPUT_DIR
from sumo_env.traffic.scenario import Scenario

# What the environment cannot do without: contacts are reported at every step and at junctions, and change nothing.
COLLISIONS = {"collision.action": "warn", "collision.check-junctions": "true", "collision.mingap-factor": "0"}
SILENT = {"no-step-log": "true", "no-warnings": "true", "duration-log.disable": "true"}
# [s] The ego's centre then crosses the line between two lanes when highway-env's does, after 0.45 to 0.5 s.
LANE_CHANGE_DURATION = 0.8

# Of scenarios of SUMO's files, where neither the files nor the user say otherwise.
# No schemas: SUMO would fetch them where a file says, and expand what a document type declares.
UNCHECKED = {"xml-validation": "never", "xml-validation.net": "never", "xml-validation.routes": "never"}
USUAL = {"lanechange.duration": "0", **UNCHECKED, **SILENT}

NOISY = {"carFollowModel", "sigma", "lcSigma"}  # attributes with which SUMO's drivers may draw random numbers


@dataclass(frozen=True)
class Settings:
    """What SUMO is loaded with."""

    options: Mapping[str, str]  # of SUMO, by their long names without dashes
    elements: str = ""  # contents of one more additional file, as XML


def placed_settings(
    network: Network, step_length: float, types: Mapping[str, Mapping[str, str]], further: Mapping[str, str]
) -> Settings:
    """Settings for vehicles that this package places itself, of these types; further: options that a user adds."""
    root = ElementTree.Element("additional")
    for name, attributes in types.items():
        ElementTree.SubElement(root, "vType", {"id": name, **attributes})
    for name, edges in network.routes.items():
        ElementTree.SubElement(root, "route", {"id": name, "edges": " ".join(edges)})
    options = {
        "net-file": str(network.net_file),
        "step-length": f"{step_length:.6g}",
        "lanechange.duration": f"{LANE_CHANGE_DURATION:g}",
        **COLLISIONS,
        "time-to-teleport": "-1",
        "max-depart-delay": "-1",
        "default.speeddev": "0",
        **UNCHECKED,
        **SILENT,
        "seed": "42",  # nobody draws, unless `leaves_traces`
        **{name: value for name, value in further.items() if name != OUTPUT_DIR},
    }
    return Settings(options, ElementTree.tostring(root, "unicode"))


def file_settings(scenario: Scenario, further: Mapping[str, str], outputs: Path | None = None) -> Settings:
    """Settings for `SumoTraffic`, with the seed of the scenario; further: options of SUMO that a user adds.

    outputs: folder into which SUMO writes all its files, those of detectors in additional files included; by default
    they are where files and options say.
    """
    assert scenario.traffic is not None
    given = dict(further)
    options = {**USUAL, **dict(scenario.traffic.options)}
    if added := listed(options.get("additional-files"), given.pop("additional-files", None)):
        options["additional-files"] = added
    all_are_wanted = given.pop(OUTPUT_DIR, None)
    if outputs is not None and not all_are_wanted:  # but those that the user names
        for name in written(given):
            link = outputs / f"{name}-{Path(given[name]).name}"
            link.unlink(missing_ok=True)
            link.symlink_to(Path(given[name]).absolute())
            given[name] = link.name
    if outputs is not None:
        given |= prefix(outputs)
    seed = scenario.seed if scenario.traffic.seed is None else scenario.traffic.seed
    # SUMO can be asked how far a vehicle drove that has left the road in the last step
    options |= {**given, **COLLISIONS, "seed": str(seed), "keep-after-arrival": options["step-length"]}
    return Settings(options, scenario.traffic.elements)


def leaves_traces(scenario: Scenario) -> bool:
    """Whether the next episode would owe something to this one, were it only removed from the road.

    Other car-following models draw from SUMO's random numbers.
    """
    attributes = (name for spec in scenario.everybody for name, _ in spec.driver.attributes)
    return any(name in NOISY or name.endswith("Prob") for name in attributes)
