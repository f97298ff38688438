"""Says what has to be installed, in place of a traceback; the commands import it before anything else."""

import sys
from importlib.util import find_spec

NEEDED = (
    "jinja2",
    "matplotlib",
    "numba",
    "pandas",
    "pebble",
    "pyarrow",
    "scipy",
    "threadpoolctl",
    "torch",
    "tyro",
)  # extra [study]

if missing := [name for name in NEEDED if find_spec(name) is None]:
    if {"-h", "--help"} & set(sys.argv):
        print(getattr(sys.modules["__main__"], "__doc__", ""))
    sys.stderr.write(
        f"error: {', '.join(missing)} not installed for {sys.executable}: run make setup first, and then "
        ". .venv/bin/activate (or pip install '.[study]')\n"
    )
    sys.exit(2)
