"""Agents that arrive: DQN of Stable-Baselines3 and of this project on three scenarios of SUMO, beside drivers that do
not learn (pip install stable-baselines3 eclipse-sumo, and this package).

    python examples/arrive.py --out arrive.json              # all, some hours; continues where it stopped
    python examples/arrive.py --only ramp/sb3-dqn --steps 2000 --episodes 10

ramp: from the acceleration lane between the cars of a motorway, and on. grid: a left turn, where others come towards
the ego, a right turn and three traffic lights, which the agent has to learn. town: three trips through Braunschweig,
where the ego obeys its light by itself. Roads, traffic, horizon and seeds of the grid were fixed before any agent was
trained on this grid; only the agent's side (observation, rewards, settings of learners) was tuned, on other seeds.
Each line counts how 100 episodes ended. Training and the choice of settings used other seeds.
"""

import argparse
import json
import subprocess
import tempfile
import time
from collections import Counter
from pathlib import Path

import gymnasium as gym
import sumolib
import torch

from sumo_env.scenarios import SumoDrivingEnv
from sumo_env.scene import ON_ITS_WAY

TEST = 10_000  # first seed of the test's episodes

RAMP = {
    "node-files": '<nodes><node id="west" x="-300" y="0"/><node id="south" x="-250" y="-100"/>'
    '<node id="on" x="0" y="0"/><node id="off" x="250" y="0" type="zipper"/><node id="east" x="650" y="0"/></nodes>',
    "edge-files": '<edges><edge id="main" from="west" to="on" numLanes="2" speed="30" priority="10"/>'
    '<edge id="ramp" from="south" to="on" numLanes="1" speed="20" priority="2"/>'
    '<edge id="merge" from="on" to="off" numLanes="3" speed="30" priority="10"/>'
    '<edge id="out" from="off" to="east" numLanes="2" speed="30" priority="10"/></edges>',
    "connection-files": '<connections><connection from="main" to="merge" fromLane="0" toLane="1"/>'
    '<connection from="main" to="merge" fromLane="1" toLane="2"/>'
    '<connection from="ramp" to="merge" fromLane="0" toLane="0"/>'
    '<connection from="merge" to="out" fromLane="1" toLane="0"/>'
    '<connection from="merge" to="out" fromLane="2" toLane="1"/></connections>',
}
GRID = "--grid --grid.number=2 --grid.length=150 --grid.attach-length=150 -L=2 --no-turnarounds --tls.cycle.time=50"
GRID_ROUTES = (
    *("left0A0 A0B0 B0right0", "right0B0 B0A0 A0left0", "left1A1 A1B1 B1right1", "right1B1 B1A1 A1left1"),
    *("bottom0A0 A0A1 A1top0", "bottom1B0 B0B1 B1top1", "top1B1 B1B0 B0bottom1"),
)
# Braunschweig, from OpenStreetMap, in the wheel of eclipse-sumo: a game, whose traffic light waits for the player.
TOWN = ("tools/game/bs3d/bs.net.xml", "--tls.rebuild")
TRIPS = [("38167741#2", "23207363#0"), ("23209601#2", "29136063#3"), ("61734682#1", "30425847#1")]
CONFIG = {
    "ramp": {"vehicles_count": 10, "spawn_probability": 0.5, "duration": 60, "policy_frequency": 2},
    "grid": {"vehicles_count": 12, "spawn_probability": 0.5, "duration": 120, "simulation_frequency": 5},
    "town": {"warm_up": 30, "duration": 120, "simulation_frequency": 5, "obey_traffic_lights": True},
}
# On the grid the agent sees the ego's row alone, with what it was told last and to whom it has to give way.
FEATURES = ["vx", *ON_ITS_WAY, "foe_gap", "foe_speed", "target_speed"]
CONFIG["grid"]["observation"] = {"type": "Kinematics", "vehicles_count": 1, "features": FEATURES}
# What differs for drivers that do not learn.
CONFIG_OF = {
    "SUMO": {"action": {"type": "DiscreteMetaAction", "longitudinal": "sumo", "lateral": "sumo"}},
    "careful": {"observation": {"type": "Kinematics"}},  # the whole table
}
CONSTANTS = ("LANE_LEFT", "IDLE", "LANE_RIGHT", "FASTER", "SLOWER")


def make(name, folder, config=None):
    """The environment of a scenario, with its files in this folder; config: what differs from `CONFIG`."""
    folder = Path(folder)
    net, command = folder / f"{name}.net.xml", ["netconvert"]
    if name == "ramp":
        for kind, text in RAMP.items():
            (folder / f"{kind}.xml").write_text(text)
            command.append(f"--{kind}={folder / kind}.xml")
        scenario = {"routes": [["main", "merge", "out"]], "ego_route": ["ramp", "merge", "out"]}
    elif name == "grid":
        command = ["netgenerate", *GRID.split(), "--default-junction-type=traffic_light"]
        routes = [route.split() for route in GRID_ROUTES]
        scenario = {"routes": routes, "ego_route": ["left0A0", "A0B0", "B0B1", "B1right1"]}
    else:
        import sumo

        command += ["-s", f"{sumo.SUMO_HOME}/{TOWN[0]}", *TOWN[1:]]
        flows = [
            f'<flow id="{k}" begin="0" end="300" probability="0.1" from="{start}" to="{end}"/>'
            for k, (start, end) in enumerate(TRIPS)
        ]
        (folder / "town.rou.xml").write_text(f"<routes>{''.join(flows)}</routes>")
        scenario = {"routes": folder / "town.rou.xml", "ego_trips": TRIPS}
    if not net.exists():
        tool = sumolib.checkBinary(command[0])
        subprocess.run([tool, *command[1:], f"--output-file={net}"], check=True, capture_output=True)
    return SumoDrivingEnv(net, **scenario, config={**CONFIG[name], **(config or {})})


def drive(env, act, seeds, begin=lambda seed: None):
    """Count how episodes end, where those end that do not arrive, and in how many a red light was run."""
    ends, where, red = Counter(), Counter(), 0
    for seed in seeds:
        observation, info = env.reset(seed=seed)
        begin(seed)
        over = ran = False
        while not over:
            observation, _, terminated, truncated, info = env.step(act(observation))
            ran |= info["red_light"]
            over = terminated or truncated
        ends[info["ending"]] += 1
        red += ran
        if not info["arrived"]:
            edge, _, end = env.unwrapped.scene.place.lane[0].partition(":")
            what = info["crash"].get("type", info["ending"])
            where[f"{what} {'on' if end == 'from' else 'after'} {edge}"] += 1
    counts = {**dict(sorted(ends.items())), "ran a red light": red}
    return {**counts, "where": dict(where.most_common())} if where else counts


def sb3_dqn(env, seed, steps, epsilon=0.05, norm_obs=True):
    """Train Stable-Baselines3's DQN."""
    from stable_baselines3 import DQN
    from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

    flat = gym.wrappers.FlattenObservation(env)
    seen = VecNormalize(DummyVecEnv([lambda: flat]), norm_obs=norm_obs, norm_reward=False)
    model = DQN(
        "MlpPolicy",
        seen,
        seed=seed,
        learning_rate=lambda left: 5e-4 * left,
        gamma=0.98,
        buffer_size=50_000,
        learning_starts=1000,
        batch_size=64,
        train_freq=4,
        gradient_steps=2,
        target_update_interval=500,
        exploration_fraction=0.4,
        exploration_final_eps=epsilon,
        policy_kwargs={"net_arch": [256, 256]},
    ).learn(steps)
    return lambda table: int(model.predict(seen.normalize_obs(table.ravel()), deterministic=True)[0])


def own_dqn(env, seed, steps, **settings):
    """Train this project's double DQN."""
    from agents.dqn import DQNConfig, train

    budget = {"updates": (steps - 1000) // 2, "steps_per_update": 2, "batch_size": 100, "n_steps": 1}
    given = {"gamma": 0.98, "tau": 0.005, "clip_goals": False, "by_hand": False, **budget, **settings}
    return train(env, DQNConfig(**given), seed).policy.act


LEARNERS = {"sb3-dqn": sb3_dqn, "dqn": own_dqn}
STEPS = {"sb3-dqn": 50_000, "dqn": 30_000, "grid": 100_000}  # of the environment
# On the grid random actions are fewer: in a queue at a light most of these end in a crash. Its features have ranges,
# and some hardly change in the first random steps, so they are not standardised.
SETTINGS = {
    "grid/sb3-dqn": {"epsilon": 0.02, "norm_obs": False},
    "grid/dqn": {"epsilon_final": 0.02, "network": "dueling", "standardise": False},
}


def rows(seeds):
    """Names of all lines: what is driven, and by whom."""
    for name in CONFIG:
        yield from (f"{name}/{driver}" for driver in (*CONSTANTS, "careful", "SUMO"))
        yield from (f"{name}/{learner}/{seed}" for learner in LEARNERS for seed in seeds)


def row(key, folder, seeds, steps):
    """One line: endings at risk 0 and 1, and the CPU seconds of the training."""
    name, driver, *seed = key.split("/")
    found, act, begin = {}, lambda _: 0, lambda seed: None
    env = make(name, folder, CONFIG_OF.get(driver))
    if driver in LEARNERS:
        began = time.process_time()
        steps = steps or STEPS.get(name, STEPS[driver])
        act = LEARNERS[driver](env, int(seed[0]), steps, **SETTINGS.get(f"{name}/{driver}", {}))
        found["training CPU s"] = round(time.process_time() - began)
        print(key, found, flush=True)
    for risk in (0, 1):
        env.configure({"risk": risk})
        if driver == "careful":
            from agents.rules import make_policy

            rule = make_policy("careful", env)
            act, begin = rule.act, rule.reset
        elif driver in CONSTANTS:
            number = next(number for number, action in env.actions.items() if action == driver)
            act = lambda _, number=number: number  # noqa: E731
        found[f"risk {risk}"] = drive(env, act, seeds, begin)
    env.close()
    return found


def stored(out):
    """All lines that are there; another process may write some as well."""
    return json.loads(out.read_text()) if out.exists() else {}


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", default="arrive.json")
    parser.add_argument("--only", default="", help="lines whose names begin so, such as grid/dqn")
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2], help="of the trainings")
    parser.add_argument("--steps", type=int, help="of a training")
    parser.add_argument("--episodes", type=int, default=100, help="of the test, at each dose")
    args = parser.parse_args()
    torch.set_num_threads(1)
    out = Path(args.out)
    with tempfile.TemporaryDirectory() as folder:
        for key in rows(args.seeds):
            if key.startswith(args.only) and key not in stored(out):
                line = row(key, folder, range(TEST, TEST + args.episodes), args.steps)
                out.write_text(json.dumps({**stored(out), key: line}, indent=1) + "\n")
                print(key, line, flush=True)
