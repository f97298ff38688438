"""The attributes that SUMO's vehicle types may have, as its own schema lists them."""

from __future__ import annotations

import difflib
import importlib.util
from collections.abc import Iterable
from functools import lru_cache
from pathlib import Path
from xml.etree import ElementTree

PAGE = "https://sumo.dlr.de/docs/Definition_of_Vehicles%2C_Vehicle_Types%2C_and_Routes.html"
SCHEMA = "data/xsd/types/route.xsd"  # of the package sumo-data, which libsumo installs
_XSD = "{http://www.w3.org/2001/XMLSchema}"


@lru_cache(maxsize=1)
def known_attributes() -> frozenset[str]:
    """Attributes of a vType and of every car-following model; empty where SUMO's schema is not installed."""
    found = importlib.util.find_spec("sumo_data")
    file = Path(next(iter(found.submodule_search_locations or ()), "") if found else "") / SCHEMA
    if not file.is_file():
        return frozenset()
    types = ElementTree.parse(file).getroot().iter(f"{_XSD}complexType")
    return frozenset(
        attribute.get("name", "")
        for kind in types
        if (name := kind.get("name", "")) == "vTypeBaseType" or name.startswith("cf")
        for attribute in kind.iter(f"{_XSD}attribute")
    )


def check_attributes(name: str, attributes: Iterable[str]) -> None:
    """That SUMO knows these attributes of the vehicle type `name`; it ignores all others without a word.

    Raises:
        ValueError: it does not; the message names the nearest one.
    """
    known = known_attributes()
    for attribute in attributes if known else ():
        if attribute not in known:
            near = difflib.get_close_matches(attribute, sorted(known), n=1, cutoff=0.5)
            raise ValueError(
                f"{name!r} has an attribute that SUMO's vehicle types do not have, {attribute!r}: "
                + (f"did you mean {near[0]!r}?" if near else f"see {PAGE}")
            )
