"""What SUMO's own schemas list: attributes of vehicle types, options of configurations."""

import importlib.util
import math
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from xml.etree import ElementTree

from sumo_env.config import did_you_mean, nearest, warn_once

PAGE = "https://sumo.dlr.de/docs/Definition_of_Vehicles%2C_Vehicle_Types%2C_and_Routes.html"
TYPES = "data/xsd/types"  # of the package sumo-data, which libsumo installs
_XSD = "{http://www.w3.org/2001/XMLSchema}"
_MODEL = "carFollowing-"  # how elements with the parameters of a model begin
# Attributes that more models have than the schema says.
_OF_MANY = {
    *("accel", "decel", "tau", "emergencyDecel", "apparentDecel", "collisionMinGapFactor"),
    *("maxAccelProfile", "desAccelProfile"),
}
# Types of numbers, with the least one; of "positive..." it is not among them.
_NUMBERS = {
    "floatType": -math.inf,
    "xsd:float": -math.inf,
    "nonNegativeFloatType": 0.0,
    "positiveFloatType": 0.0,
}


@cache
def schema(name: str) -> dict[str, dict[str, str]]:
    """The types of one of SUMO's schemas: names of their attributes and elements -> types; empty without a schema."""
    found = importlib.util.find_spec("sumo_data")
    folder = Path(next(iter(found.submodule_search_locations or ()), "") if found else "")
    if not (file := folder / TYPES / f"{name}.xsd").is_file():
        return {}
    kinds = ElementTree.parse(file).getroot().iter(f"{_XSD}complexType")
    parts = {kind.get("name", ""): kind.iter() for kind in kinds}
    return {
        kind: {part.get("name", ""): part.get("type", "") for part in inner} for kind, inner in parts.items()
    }


def check_attributes(name: str, attributes: Mapping[str, object]) -> None:
    """That SUMO knows these attributes of the vehicle type `name`, its model and its class, and that numbers are such.

    Other wrong values it refuses itself when an episode begins. Warns of attributes of other models than its own.

    Raises:
        ValueError: it does not; the message names the nearest one, or what a value may be.
    """
    kinds = schema("route")
    # of all models; empty without a schema, as these, of which it lacks two:
    known = kinds.get("vTypeBaseType", {})
    models = {key.removeprefix(_MODEL): kinds[kind] for key, kind in known.items() if key.startswith(_MODEL)}
    models |= {"Rail": {}, "KraussX": {}} if models else {}
    model = str(attributes.get("carFollowModel", "IDM"))
    if models and model not in models:
        raise ValueError(f"SUMO has no carFollowModel {model!r}, as {name!r} has: {nearest(model, models)}")
    for attribute in attributes if known else ():
        if attribute not in known:
            instead = did_you_mean(attribute, known) or f"see {PAGE}"
            raise ValueError(f"SUMO's types have no attribute {attribute!r}, as {name!r} has: {instead}")
        _check_number(attribute, attributes[attribute], known[attribute], name)
    own, of_models = models.get(model, {}), {key for of_model in models.values() for key in of_model}
    if own and (foreign := sorted((of_models & attributes.keys()) - own.keys() - _OF_MANY)):
        warn_once(f"the carFollowModel {model!r} of {name!r} has no {', '.join(foreign)}: without effect")
    if "vClass" in attributes:
        from sumolib.net.lane import SUMO_VEHICLE_CLASSES  # late: it takes a tenth of a second

        if (given := str(attributes["vClass"])) not in SUMO_VEHICLE_CLASSES:
            raise ValueError(
                f"SUMO has no vClass {given!r}, as {name!r} has: {nearest(given, SUMO_VEHICLE_CLASSES)}"
            )


def _check_number(attribute: str, value: object, kind: str, name: str) -> None:
    """Raise ValueError unless a value of a type of numbers is one."""
    if kind not in _NUMBERS:
        return
    least, above = _NUMBERS[kind], kind == "positiveFloatType"
    try:
        number = float(str(value))
    except ValueError:
        number = math.nan
    if not math.isfinite(number) or number < least or (above and number == least):
        said = "a number" if least < 0 else "above 0" if above else "0 or more"
        raise ValueError(f"{attribute} of {name!r} has to be {said}, not {value!r}")
