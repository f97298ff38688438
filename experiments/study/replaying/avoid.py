"""Whether a crash could have been avoided: every sequence of actions before it, driven in copies of the environment.

A search begins at the start of a policy step, in the traffic and with the future of the stored episode. It tries all
sequences of a few actions, depth first: sequences that begin alike share a copy up to where they part, and of two
actions with the same effect one is driven. Where the horizon ends before SAFE seconds are over, each of REST is
repeated up to then. The crash is avoided if the ego has no contact for SAFE seconds, or until the episode ends.

An upper bound of what a driver could have done: the search knows the future. And a lower one of what was possible: the
ego decides at policy steps alone, and after the horizon it only repeats.
"""

import copy
import math
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from typing import Any

from experiments.study.compute.evaluate import repeat
from experiments.study.replaying.rerun import Case, differences, play_again
from experiments.support.errors import UserError

HORIZON = 5  # policy steps in which all sequences are tried
SAFE = 5.0  # [s] without a contact, after which a crash counts as avoided
REST = ("IDLE", "SLOWER")  # what is repeated after the horizon; within it these are tried first


def way_out(env: Any, horizon: int = HORIZON) -> tuple[tuple[int, ...] | None, int]:
    """Actions that avoid a contact from the present state on (None: no sequence does), and the contacts met.

    The environment stays as it is. horizon: policy steps in which all sequences are tried.
    """
    contacts = 0

    def search(env: Any, free: int, steps: int) -> tuple[int, ...] | None:
        """Actions for these steps without a contact, the first `free` ones chosen freely; None if there are none."""
        nonlocal contacts
        if steps == 0:
            return ()
        choices = sorted(env.actions, key=lambda action: env.actions[action] not in REST)
        effects = set()
        for action in choices if free else choices[: len(REST)]:
            with closing(copy.deepcopy(env)) as twin:
                taken, crashed, over = repeat(twin, action, 1 if free else steps)
                contacts += crashed
                if over and not crashed:
                    return taken
                if not crashed and (effect := _effect(twin)) not in effects:
                    effects.add(effect)
                    rest = search(twin, max(free - 1, 0), steps - len(taken))
                    if rest is not None:
                        return taken + rest
        return None

    steps = math.ceil(SAFE * env.config["policy_frequency"])
    return search(env, min(horizon, steps), steps), contacts


def _effect(env: Any) -> tuple[Any, ...]:
    """What is different after actions of different effect, from the same state: the ego's commands and its motion."""
    ego = env.vehicle
    return (ego.target_lane_index, ego.speed_index, *ego.position, ego.speed, ego.heading)


@contextmanager
def rewound(case: Case, env: Any) -> Iterator[tuple[list[Any], tuple[int, ...]]]:
    """A stored crash, driven again: copies of its environment before every step and at the end, and the actions.

    env: an environment of the case's cell.

    Raises:
        UserError: the episode has no crash, cannot be driven again, or comes out differently now.
    """
    if not case.row["crashed"]:
        raise UserError(f"{case.name} has no crash that could be avoided")
    with ExitStack() as opened:
        copies: list[Any] = []

        def keep() -> None:
            copies.append(opened.enter_context(closing(copy.deepcopy(env.unwrapped))))

        again = play_again(case, env, keep)
        if wrong := differences(case.row, again):
            raise UserError(f"{case.name} is not reproduced: {'; '.join(wrong)}")
        yield copies, tuple(map(int, again["actions"]))
