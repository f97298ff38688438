"""Roundabout entry with hand-over: the agent decides when to enter, and SUMO drives in the ring and on from there."""

from pathlib import Path

from sumo_env.scenarios import HandOver, SumoDrivingEnv

NETWORK = Path(__file__).parent / "networks" / "roundabout.net.xml"
# once around from every entry but the ego's, so that all of them pass its entry, and one exit of three
ROUTES = [
    [f"in{k}", *(f"ring{(k + i) % 4}" for i in range(count)), f"out{(k + count) % 4}"]
    for k in (0, 1, 2)
    for count in (2, 3)
]
CONFIG = {
    "action": {"type": "DiscreteMetaAction", "lateral": False, "target_speeds": [0, 6, 12]},
    "vehicles_count": 8,
    "spawn_probability": 0.6,
    "duration": 60,
}


def make(**keywords):
    """The environment."""
    env = SumoDrivingEnv(NETWORK, ROUTES, ["in3", "ring3", "ring0", "out1"], CONFIG, **keywords)
    return HandOver(env, lambda env: env.scene.place.ahead[0] != "in3")


if __name__ == "__main__":
    from train import main

    main("roundabout", make, "DQN", steps=8_000)
