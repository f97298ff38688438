"""Agents to use without training: of each arm and setting of the study, in one file.

    policy = agents.load("u-turn-3", "treatment")
    env = gymnasium.make("sumo_env:sumo/u-turn-v0", config=agents.card("u-turn-3", "treatment")["config"])

`python -m experiments.study.replaying.publish` writes the file.
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from agents.files import DamagedFile, load_arrays, save_arrays
from agents.plugins import unknown

if TYPE_CHECKING:
    from agents.greedy import Greedy
    from agents.models import Network

FILE = Path(__file__).resolve().parents[1] / "results" / "agents.npz"
CARDS = "cards"  # the entry with the cards as JSON; an agent's weights are the entries "SETTING/ARM/NAME"


def cards(file: str | Path = FILE) -> dict[str, dict[str, Any]]:
    """What there is: a card for each agent, by "SETTING/ARM".

    A card says how the agent drives in its test, per traffic ("regular", "risky"): `crash_rate`, `return` and `speed`
    [m/s], each with the ends of its 95 % interval over `episodes` scenarios; the `config` of its environment; its
    `cell`, with the `command` and `commit` that trained it; `time_observed`, the number of steps of which the agent
    observes the share that is over (0: it does not observe the time).

    Raises FileNotFoundError when the file is not there, DamagedFile when it is damaged.
    """
    if not Path(file).exists():
        raise FileNotFoundError(f"no {file}: python -m experiments.study.replaying.publish DIR writes it")
    arrays = load_arrays(file, CARDS)
    try:
        found: dict[str, dict[str, Any]] = json.loads(str(arrays[CARDS]))
    except (KeyError, ValueError) as error:
        raise DamagedFile(f"{file} is no file of agents ({error}): restore it from a copy.") from None
    return found


def card(setting: str, arm: str, file: str | Path = FILE) -> dict[str, Any]:
    """The card of one agent, see :func:`cards`. Raises ValueError when there is no such agent."""
    known, wanted = cards(file), f"{setting}/{arm}"
    if wanted not in known:
        raise unknown("agent", wanted, known)
    return known[wanted]


def load(setting: str, arm: str, file: str | Path = FILE, network: "Network | None" = None) -> "Greedy":
    """The greedy policy of an agent, for example of the setting "u-turn-3" and the arm "treatment".

    Call its ``reset()`` when an episode begins: some agents observe the time, which they count themselves.

    `network`: the class of an agent whose network is not one of ours; a file alone never runs code of its author.

    Raises ValueError when there is no such agent or its network is needed, FileNotFoundError or DamagedFile when
    the file is not in order.
    """
    import gymnasium as gym

    from agents.greedy import Greedy, Timed, with_weights
    from agents.models import NETWORKS, Standardised

    about, prefix = card(setting, arm, file), f"{setting}/{arm}/"
    kind = network or NETWORKS.get(about["network"])
    if kind is None:
        raise ValueError(
            f"{file}: the network {about['network']!r} is none of ours. Give its class: load(..., network=...)"
        )
    space = gym.spaces.Box(-np.inf, np.inf, about["observations"], np.float32)
    inner = Standardised(kind(space, about["actions"]), space)
    weights = {
        name.removeprefix(prefix): array.astype(np.float32) if array.dtype.kind == "f" else array
        for name, array in load_arrays(file, prefix).items()
    }
    with_weights(inner, weights, file)
    steps = about["time_observed"]
    return Timed(inner, steps) if steps else Greedy(inner)


def save(agents: Mapping[str, tuple[Mapping[str, Any], "Greedy"]], file: str | Path = FILE) -> None:
    """Write agents with their cards, by "SETTING/ARM", and their weights in half precision."""
    arrays = {CARDS: np.array(json.dumps({name: about for name, (about, _) in agents.items()}))}
    for name, (_, policy) in agents.items():
        for part, value in policy.network.state_dict().items():
            arrays[f"{name}/{part}"] = (value.half() if value.is_floating_point() else value).numpy()
    save_arrays(file, arrays)
