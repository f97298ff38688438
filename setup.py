"""Refuses to build where the folder of the roads is missing; everything else is in pyproject.toml."""

from pathlib import Path

from setuptools import setup

if not (Path(__file__).parent / "sumo_env" / "networks" / "__init__.py").is_file():
    raise SystemExit(
        "sumo_env/networks should be a link to the folder networks, but this copy was made without symbolic links. "
        "In a clone: git config core.symlinks true && git checkout -- sumo_env/networks (on Windows in developer "
        "mode); else copy the folder networks there."
    )

setup()
