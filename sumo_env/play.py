"""Drive by hand: python -m sumo_env.play --task u-turn --risk 1

Arrow keys: right FASTER, left SLOWER, up LANE_LEFT, down LANE_RIGHT. Close the window to stop.
"""

import argparse
from collections.abc import Sequence
from itertools import count

from sumo_env.config import ConfigError
from sumo_env.env import DrivingEnv
from sumo_env.tasks import TASKS


def main(arguments: Sequence[str] | None = None) -> None:
    """Drive episodes until the window is closed, and say how each has ended.

    Raises:
        SystemExit: a wrong argument (2); pygame is missing (1).
    """
    parser = argparse.ArgumentParser(prog="python -m sumo_env.play", description=__doc__)
    parser.add_argument("--task", default="highway", choices=tuple(TASKS))
    parser.add_argument("--risk", type=float, default=0.0, help="dose of risky traffic, 0 to 1")
    parser.add_argument("--seed", type=int, default=0, help="of the first episode")
    parser.add_argument("--episodes", type=int, default=0, help="how many; 0 for as many as you like")
    given = parser.parse_args(arguments)
    try:
        env = DrivingEnv(given.task, {"risk": given.risk, "manual_control": True}, render_mode="human")
    except ConfigError as error:
        parser.error(str(error))
    except ImportError as error:  # of pygame
        raise SystemExit(str(error)) from None
    for seed in count(given.seed):
        env.reset(seed=seed)
        total, over = 0.0, False
        while not over:
            _, reward, terminated, truncated, info = env.step(0)
            total, over = total + reward, terminated or truncated
        if env.render_mode is None:  # the window was closed
            break
        print(f"seed {seed}: {info['ending']} after {env.scene.time:.1f} s, return {total:.2f}")
        if seed + 1 == given.seed + given.episodes:
            break
    env.close()


if __name__ == "__main__":
    main()
