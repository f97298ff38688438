"""``python -m sumo_env`` checks the installation."""

import sys

from sumo_env.doctor import main

if __name__ == "__main__":
    sys.exit(main())
