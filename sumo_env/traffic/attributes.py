"""The attributes that SUMO's vehicle types may have, as its own schema lists them."""

from __future__ import annotations

import importlib.util
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from xml.etree import ElementTree

from sumo_env.config import did_you_mean, nearest

PAGE = "https://sumo.dlr.de/docs/Definition_of_Vehicles%2C_Vehicle_Types%2C_and_Routes.html"
SCHEMA = "data/xsd/types/route.xsd"  # of the package sumo-data, which libsumo installs
_XSD = "{http://www.w3.org/2001/XMLSchema}"
MODEL = "carFollowing-"  # how the schema's elements for car-following models begin
FURTHER_MODELS = {"KraussX", "Rail"}  # that the schema does not have
LEAST = {"positiveFloatType": "above 0", "nonNegativeFloatType": "at least 0"}


@lru_cache(maxsize=1)
def _schema() -> tuple[Mapping[str, str], set[str]]:
    """Types of the attributes of a vType and of every car-following model, and the models; empty without a schema."""
    found = importlib.util.find_spec("sumo_data")
    file = Path(next(iter(found.submodule_search_locations or ()), "") if found else "") / SCHEMA
    if not file.is_file():
        return {}, set()
    root = ElementTree.parse(file).getroot()
    types = {
        attribute.get("name", ""): attribute.get("type", "")
        for kind in root.iter(f"{_XSD}complexType")
        if (name := kind.get("name", "")) == "vTypeBaseType" or name.startswith("cf")
        for attribute in kind.iter(f"{_XSD}attribute")
    }
    elements = [element.get("name", "") for element in root.iter(f"{_XSD}element")]
    models = {name.removeprefix(MODEL) for name in elements if name.startswith(MODEL)}
    return types, models | FURTHER_MODELS


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


def check_attributes(name: str, attributes: Mapping[str, object]) -> None:
    """That SUMO knows these attributes of the vehicle type `name`, and that their values are numbers where it asks so.

    SUMO ignores unknown attributes without a word, and refuses wrong values when an episode begins.

    Raises:
        ValueError: it does not; the message names the nearest one.
    """
    types, models = _schema()
    for attribute, value in attributes.items() if types else ():
        if attribute not in types:
            raise ValueError(
                f"{name!r} has an attribute that SUMO's vehicle types do not have, {attribute!r}: "
                f"{did_you_mean(attribute, types) or f'see {PAGE}'}"
            )
        if attribute == "carFollowModel" and value not in models:
            known = nearest(str(value), models)
            raise ValueError(f"carFollowModel of {name!r} is {value!r}, which SUMO does not have: {known}")
        if types[attribute].endswith("loatType") and not _is_number(value, types[attribute]):
            least = LEAST.get(types[attribute], "")
            raise ValueError(
                f"{attribute} of {name!r} must be a number {least}".rstrip() + f", not {value!r}"
            )


def _is_number(value: object, kind: str) -> bool:
    try:
        number = float(str(value))
    except ValueError:
        return False
    return number > 0.0 or kind not in LEAST or (number == 0.0 and kind != "positiveFloatType")
