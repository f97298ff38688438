"""Write results/agents.npz: agents of a study on SUMO, with their weights in half precision.

    python -m experiments.study.replaying.publish results/study-6

Of each arm and setting the agent with the lowest training seed, as ARM; in the lightest setting of a task all agents,
the others as ARM-sSEED. Agents of other settings that are in the file stay. Agents that observe the dose are left out.
"""

from contextlib import closing
from pathlib import Path
from typing import Annotated, Any

import tyro

from agents import pretrained
from agents.greedy import Greedy, Timed
from experiments.backends import make_env
from experiments.study.compute.evaluate import driving
from experiments.study.compute.policies import driver
from experiments.study.compute.wrappers import TimeObserved
from experiments.study.design.cell import LEARNER, tested_on
from experiments.study.design.levels import env_config, level_config
from experiments.study.results.schema import EPISODES
from experiments.study.results.store import Store
from experiments.support.errors import run_command


def published(directory: Path, name: str, command: str) -> tuple[dict[str, Any], Greedy] | None:
    """Card and policy of a stored agent.

    None of another's learner or network, or if it observes the dose, which nobody knows, or an estimate of it.
    """
    store = Store(directory)
    record, weights = store.record(name), store.weights(name)
    assert weights is not None
    key = record["key"]
    if ":" in key["profile"]["network"]:
        return None
    with closing(make_env(*tested_on(key))) as env:
        seen, policy = driver(key, None, env, weights)
        if "dose_observed" in key["profile"] or key["policy"] != LEARNER or not isinstance(policy, Greedy):
            return None
        space: Any = seen.observation_space
        steps = seen.steps if isinstance(seen, TimeObserved) else 0
        if steps:
            policy = Timed(policy.network, steps)
        actions: Any = env.action_space
    config = level_config(key["task"], key["level_name"])
    usual = env_config("sumo", key["task"], key["level"])["observation"]
    if (seen_as := key["env_config"]["observation"]) != usual:
        config["observation"] = seen_as
    about: dict[str, Any] = {
        "cell": name,
        "command": f"{command} --cell {name}",
        "commit": record["provenance"]["git"],
        "task": key["task"],
        "config": config,
        "network": key["profile"]["network"],
        "observations": list(space.shape),
        "actions": int(actions.n),
        "time_observed": steps,
    }
    for traffic, rows in store.tables(name)[EPISODES].groupby("traffic"):
        values = {part: [round(value, 4) for value in found] for part, found in driving(rows).items()}
        about[str(traffic)] = {"episodes": len(rows), **values}
    return about, policy


def main(directory: Annotated[Path, tyro.conf.Positional], out: Path = pretrained.FILE) -> int:
    """Write the file of agents.

    Args:
        directory: a study's results on SUMO.
        out: the file.
    """
    agents: dict[str, tuple[dict[str, Any], Greedy]] = {}
    if out.exists():
        for label, about in pretrained.cards(out).items():
            setting, arm = label.split("/")
            agents[label] = about, pretrained.load(setting, arm, out)
    store = Store(directory)
    commands = {name: sweep["command"] for sweep in store.sweeps() for name in sweep["cells"]}
    chosen: dict[str, str] = {}
    for name, record in sorted(store.agents().items(), key=lambda cell: cell[1]["key"]["seed"]):
        key = record["key"]
        if key["backend"] != "sumo" or not store.weights(name):
            continue
        label = f"{key['task']}-{key['level_name']}/{key['arm']}"
        is_lightest = key["level"] == 1
        if label not in chosen:
            chosen[label] = name
        elif is_lightest:
            chosen[f"{label}-s{key['seed']}"] = name
    for label, name in sorted(chosen.items()):
        if (agent := published(directory, name, commands[name])) is not None:
            agents[label] = agent
            print(label, agent[0]["risky"]["crash_rate"])
    pretrained.save(dict(sorted(agents.items())), out)
    print(f"written: {out} ({len(agents)} agents, {out.stat().st_size / 1e6:.1f} MB)")
    return 0


if __name__ == "__main__":
    run_command(lambda: tyro.cli(main))
