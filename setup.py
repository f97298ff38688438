"""Which packages are installed; everything else is in pyproject.toml.

The roads are the folder networks, which the package has as sumo_env.networks. In the checkout, sumo_env/networks is a
link to the folder. A clone without symbolic links, as on Windows, has a file in its place, and needs no link.
"""

from setuptools import find_packages, setup

ROADS = "sumo_env.networks"
found = find_packages(include=["sumo_env*"], exclude=[ROADS, f"{ROADS}.*"])
roads = [f"sumo_env.{name}" for name in find_packages(include=["networks*"])]
setup(packages=[*found, *roads], package_dir={ROADS: "networks"})
