"""Greedy policies and their files, one for each or one for many; policies that were not made here."""

from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import torch

import agents
from agents import pretrained
from agents.compiled import Compiled
from agents.greedy import Greedy
from agents.models import EgoAttention, Standardised
from agents.plugins import sha256
from agents.policies import foreign_policy
from agents.rules import make_policy
from tests.agents.networks import weights
from tests.experiments.fake_env import FakeEnv

ROAD = FakeEnv("u-turn", {})
SPACE = gym.spaces.Box(-1, 1, (4, 5), np.float32)


def network(seed: int = 0, width: int = 64) -> Standardised:
    torch.manual_seed(seed)
    made = Standardised(EgoAttention(SPACE, 5, width), SPACE)
    made.fit(torch.rand(50, 4, 5))
    return made


@pytest.mark.parametrize("kind", [Greedy, Compiled])
def test_a_stored_policy_comes_back_with_its_statistics(kind: type[Greedy], tmp_path: Path) -> None:
    policy = kind(network())
    policy.save(tmp_path / "weights.npz")
    loaded = kind.load(tmp_path / "weights.npz", network(seed=1))
    for observation in np.random.default_rng(0).uniform(-1, 1, (20, 4, 5)):
        np.testing.assert_allclose(policy.q(observation), Greedy(network()).q(observation), atol=1e-6)
        np.testing.assert_array_equal(loaded.q(observation), policy.q(observation))
        assert loaded.act(observation) == policy.q(observation).argmax()
    assert weights(loaded) == weights(policy) != weights(Greedy(network(seed=1)))
    policy.save(tmp_path / "again.npz")
    assert (tmp_path / "again.npz").read_bytes() == (tmp_path / "weights.npz").read_bytes()


@pytest.mark.parametrize("algorithm", ["DQN", "PPO"])
def test_a_model_of_stable_baselines3_drives(tmp_path: Path, algorithm: str) -> None:
    stable_baselines3 = pytest.importorskip("stable_baselines3")
    model = getattr(stable_baselines3, algorithm)("MlpPolicy", ROAD, seed=0, device="cpu")
    model.save(tmp_path / "model.zip")
    policy, _ = foreign_policy(str(tmp_path / "model.zip"), ROAD)
    policy.reset(0)
    for observation in np.random.default_rng(0).uniform(-1, 1, (5, 2, 5)).astype(np.float32):
        assert policy.act(observation) == model.predict(observation, deterministic=True)[0]
    with pytest.raises(ValueError, match="observation_space"):
        foreign_policy(str(tmp_path / "model.zip"), gym.make("CartPole-v1"))


def test_a_model_of_a_normalised_training_sees_what_it_saw_there(tmp_path: Path) -> None:
    stable_baselines3 = pytest.importorskip("stable_baselines3")
    from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

    seen = VecNormalize(DummyVecEnv([lambda: FakeEnv("u-turn", {})]))
    model = stable_baselines3.DQN("MlpPolicy", seen, seed=0, device="cpu", learning_starts=10)
    model.learn(60)
    model.save(tmp_path / "model.zip")
    raw, _ = foreign_policy(str(tmp_path / "model.zip"), ROAD)
    seen.save(str(tmp_path / "vecnormalize.pkl"))
    policy, _ = foreign_policy(str(tmp_path / "model.zip"), ROAD)
    observations = np.random.default_rng(0).uniform(-1, 1, (50, 2, 5)).astype(np.float32)
    wanted = [model.predict(seen.normalize_obs(one), deterministic=True)[0] for one in observations]
    assert [policy.act(one) for one in observations] == wanted != [raw.act(one) for one in observations]
    (tmp_path / "vecnormalize.pkl").write_bytes(b"damaged")
    with pytest.raises(ValueError, match=r"vecnormalize.pkl cannot be read"):
        foreign_policy(str(tmp_path / "model.zip"), ROAD)


READER = """
import pathlib
import numpy as np
HERE = pathlib.Path(__file__).parent
TABLE = np.load(HERE / "table.npy")

class Policy:
    def __init__(self, text):
        self.act = lambda observation: len(text)

def make(env):
    return Policy((HERE / "weights.txt").read_text())
"""


def test_what_a_policy_is_follows_its_code_and_what_it_reads(tmp_path: Path) -> None:
    def digest() -> str:
        return foreign_policy(f"{tmp_path / 'mine.py'}:make", ROAD)[1]

    files: dict[str, tuple[bytes, bytes]] = {
        "mine.py": (READER.encode(), READER.encode() + b"# another"),
        "table.npy": (b"", b""),
        "weights.txt": (b"one", b"two"),
    }
    for name, (first, _) in files.items():
        (tmp_path / name).write_bytes(first)
    np.save(tmp_path / "table.npy", np.zeros(3))
    whole, found = (tmp_path / "table.npy").read_bytes(), {digest()}
    files["table.npy"] = whole, whole[:-1] + b"1"
    (tmp_path / "beside.txt").write_text("not read")
    assert {digest()} == found
    for name, (first, second) in files.items():
        (tmp_path / name).write_bytes(second)
        found.add(digest())
        (tmp_path / name).write_bytes(first)
    assert len(found) == 4 and digest() in found
    (tmp_path / "mine.py").write_text(
        "def make(env):\n    return type('P', (), {'act': lambda self, seen: 1})()\n"
    )
    assert digest() == sha256(tmp_path / "mine.py")


# -- trained agents in one file --------------------------------------------------------------------------------------


@pytest.fixture
def published(tmp_path: Path) -> Path:
    drives = {"episodes": 4, "crash_rate": [0.5, 0.2, 0.8], "return": [7, 6, 8], "speed": [12.0, 11.0, 13.0]}
    about = {
        **{"cell": "a cell", "command": "python experiments/sweep.py", "commit": None, "task": "u-turn"},
        **{"config": {}, "network": "attention", "observations": [4, 5], "actions": 5, "time_observed": 0},
        **{"regular": drives, "risky": drives},
    }
    stored = {"u-turn-3/mixed": (about, Greedy(network())), "u-turn-3/control": (about, Greedy(network(1)))}
    pretrained.save(stored, tmp_path / "agents.npz")
    return tmp_path / "agents.npz"


@pytest.mark.parametrize(("arm", "seed"), [("mixed", 0), ("control", 1)])
def test_an_agent_has_the_weights_that_were_stored(published, arm, seed) -> None:
    assert agents.card("u-turn-3", arm, published)["time_observed"] == 0
    loaded = agents.load("u-turn-3", arm, published).network.state_dict()
    for name, value in network(seed).state_dict().items():
        assert torch.equal(loaded[name], value.half().float()), name


def test_sumo_drives_from_the_first_step_of_every_episode() -> None:
    """Whatever the car is asked to do: it is handed over before each step, since a reset takes it back."""
    handed: list[bool] = []
    env: Any = FakeEnv("u-turn", {})
    env.hand_over = lambda: handed.append(True)
    driver = make_policy("sumo", env)
    assert [driver.act(np.zeros((2, 5))) for _ in range(2)] == [1, 1] and len(handed) == 2  # IDLE
