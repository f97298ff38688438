"""The attributes that SUMO's vehicle types may have, as its own schema lists them."""

from __future__ import annotations

import importlib.util
from collections.abc import Iterable
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
