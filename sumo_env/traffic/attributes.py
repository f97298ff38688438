"""The attributes that SUMO's vehicle types may have, as its own schema lists them."""

from __future__ import annotations

import importlib.util
from collections.abc import Iterable, Mapping
from functools import lru_cache
from pathlib import Path
from xml.etree import ElementTree

from sumo_env.config import did_you_mean

PAGE = "https://sumo.dlr.de/docs/Definition_of_Vehicles%2C_Vehicle_Types%2C_and_Routes.html"
SCHEMA = "data/xsd/types/route.xsd"  # of the package sumo-data, which libsumo installs
_XSD = "{http://www.w3.org/2001/XMLSchema}"


@lru_cache(maxsize=1)
def _known() -> set[str]:
    """Attributes of a vType, those of every car-following model included; empty without a schema."""
    found = importlib.util.find_spec("sumo_data")
    file = Path(next(iter(found.submodule_search_locations or ()), "") if found else "") / SCHEMA
    if not file.is_file():
        return set()
    return {
        attribute.get("name", "")
        for kind in ElementTree.parse(file).getroot().iter(f"{_XSD}complexType")
        if (name := kind.get("name", "")) == "vTypeBaseType" or name.startswith("cf")
        for attribute in kind.iter(f"{_XSD}attribute")
    }


# What SUMO gives the vehicles of a class: length, width [m], maxSpeed [m/s], accel, decel [m/s2]
# (https://sumo.dlr.de/docs/Vehicle_Type_Parameter_Defaults.html).
CLASSES = {
    "truck": (7.1, 2.4, 36.11, 1.3, 4.0),
    "trailer": (16.5, 2.55, 36.11, 1.0, 4.0),
    "bus": (12.0, 2.5, 23.61, 1.2, 4.0),
    "coach": (14.0, 2.6, 27.78, 2.0, 4.0),
    "delivery": (6.5, 2.16, 55.56, 2.6, 4.5),
    "emergency": (6.5, 2.16, 55.56, 2.6, 4.5),
    "motorcycle": (2.2, 0.9, 55.56, 6.0, 10.0),
    "moped": (2.1, 0.78, 12.5, 1.1, 7.0),
    "bicycle": (1.6, 0.65, 5.56, 1.2, 3.0),
}
SPECIAL = {"authority", "army", "vip", "ignoring", "custom1", "custom2"}
CARS = SPECIAL | {"passenger", "private", "taxi", "hov", "evehicle"}
LOOKS = {"guiShape", "imgFile", "color", "osgFile", "laneChangeModel"}  # in a file, without effect here


def of_class(name: str, given: Mapping[str, str]) -> dict[str, str]:
    """The attributes of a vType of a file as those of a driver: its class says its size, what it can do, and its lanes.

    Raises:
        ValueError: vehicles of this class do not drive on roads.
    """
    kind = given.get("vClass", "passenger")
    if kind not in CLASSES and kind not in CARS:
        near = did_you_mean(kind, CLASSES.keys() | CARS)
        raise ValueError(
            f"vType {name!r}: vehicles of class {kind!r} cannot be driven here; {near}".rstrip("; ")
        )
    defaults = dict(
        zip(("length", "width", "maxSpeed", "accel", "decel"), map(str, CLASSES.get(kind, ())), strict=False)
    )
    return {**defaults, **{key: value for key, value in given.items() if key not in LOOKS}}


def check_attributes(name: str, attributes: Iterable[str]) -> None:
    """That SUMO knows these attributes of the vehicle type `name`: it ignores unknown ones without a word.

    Wrong values it refuses itself when an episode begins.

    Raises:
        ValueError: it does not; the message names the nearest one.
    """
    known = _known()
    for attribute in attributes if known else ():
        if attribute not in known:
            raise ValueError(
                f"{name!r} has an attribute that SUMO's vehicle types do not have, {attribute!r}: "
                f"{did_you_mean(attribute, known) or f'see {PAGE}'}"
            )
