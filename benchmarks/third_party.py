"""Libraries that this package does not install, checked unmodified: Tianshou, RLlib, ALE, Gymnasium-Robotics and more.

    python -m benchmarks.third_party                        # all of them, some gigabytes of disk and ten minutes
    python -m benchmarks.third_party tianshou --folder F    # one; keeps its environment in F for the next time
    python -m benchmarks.third_party ale --here             # in this interpreter, which has the library

Each library is installed with this package into a virtual environment of its own in a temporary folder, because their
requirements exclude each other. Its check then runs there. Exits with 1 if a check fails.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium
import numpy as np

from hrl_escape.options import MaskedObservation
from tests.options.oracle import Skill, compare_with_copy

ROOT = Path(__file__).parents[1]
TORCH = "torch==2.13.0"
GAMMA = 0.97
KEPT = ("duration", "discount", "discounted_reward", "action_mask")
"""Entries of `info` that an agent over options reads."""


class KeepInfo(gymnasium.Wrapper):
    """Keeps the entries of `info` that an agent over options reads: buffers need entries of fixed shape."""

    def reset(self, **arguments: Any) -> tuple[Any, dict[str, Any]]:
        """Reset the environment."""
        observation, info = self.env.reset(**arguments)
        return observation, {key: info[key] for key in KEPT}

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Take one step."""
        *rest, info = self.env.step(action)
        return *rest, {key: info[key] for key in KEPT}  # type: ignore[return-value]


def make_room(**keys: str) -> gymnasium.Env:
    """A room with options alone, whose exit is masked until its buttons are on."""
    env = gymnasium.make("hrl_escape/PaperTwoButtonOptions-v1", observation="features", include_primitives=False,
                         discount=GAMMA, discounted_reward=True)
    return MaskedObservation(KeepInfo(env), **keys)


def check_decisions(masks: Any, actions: Any, rewards: Any, infos: Any) -> str:
    """Hold what a library has stored against the contract of `OptionsEnv`; returns what was compared.

    Args:
        masks: (n, actions), at the choice of each action.
        actions: (n,).
        rewards: (n,).
        infos: duration, discount and discounted reward of each decision, (3, n).
    """
    masks, actions = np.asarray(masks), np.asarray(actions).ravel()
    duration, discount, discounted = np.asarray(infos, float)
    masked = int((masks == 0).any(axis=1).sum())
    assert masked > 20, f"an action was masked in {masked} decisions: the check needs more of them"
    assert (masks[np.arange(len(actions)), actions] == 1).all(), "a masked action was chosen"
    assert duration.max() > 5
    np.testing.assert_allclose(discount, GAMMA**duration, rtol=1e-6)
    np.testing.assert_allclose(np.asarray(rewards).ravel(), discounted, rtol=1e-5)
    return f"{len(actions)} decisions, {masked} with a mask, no illegal one; duration and discount as in info"


def train_tianshou() -> str:
    """Train by `examples/tianshou_dqn.py`, with gamma^k in its targets; returns its last line."""
    done = subprocess.run([sys.executable, str(ROOT / "examples/tianshou_dqn.py")], check=True, text=True,
                          stdout=subprocess.PIPE)
    last = done.stdout.splitlines()[-1]
    found = re.search(r"return (-?[\d.]+)", last)
    assert found and float(found[1]) > 0, f"the greedy policy does not escape: {last}"
    return last


def check_tianshou() -> str:
    """Its collector, buffer and DQN, whose network prefers masked actions, and an example that trains."""
    import torch
    from tianshou.algorithm import DQN
    from tianshou.algorithm.modelfree.dqn import DiscreteQLearningPolicy
    from tianshou.algorithm.optim import AdamOptimizerFactory
    from tianshou.data import Collector, VectorReplayBuffer
    from tianshou.env import DummyVectorEnv
    from tianshou.utils.net.common import Net
    from tianshou.utils.torch_utils import policy_within_training_step

    class ExitNet(Net):
        """Values the exit, the last action, above all others."""

        def forward(self, obs: Any, state: Any = None, info: Any = None) -> tuple[torch.Tensor, Any]:
            values, state = super().forward(obs, state, info)
            return values + 100.0 * torch.nn.functional.one_hot(last, int(last) + 1), state

    def make() -> gymnasium.Env:
        return make_room(key="obs", mask_key="mask")

    np.random.seed(0)  # noqa: NPY002  # which is where its exploration draws from
    torch.manual_seed(0)
    env = make()
    last = torch.tensor(int(env.action_space.n) - 1)
    net = ExitNet(state_shape=env.observation_space["obs"].shape, action_shape=int(env.action_space.n),
                  hidden_sizes=[16])
    policy = DiscreteQLearningPolicy(model=net, action_space=env.action_space, eps_training=0.5, eps_inference=0.5)
    algorithm = DQN(policy=policy, optim=AdamOptimizerFactory(lr=1e-3), gamma=GAMMA, target_update_freq=10)
    buffer = VectorReplayBuffer(400, 2)
    collector = Collector(algorithm, DummyVectorEnv([make, make]), buffer, exploration_noise=True)
    collector.reset(gym_reset_kwargs={"seed": 0})
    collector.collect(n_step=200)
    batch, _ = buffer.sample(0)
    told = check_decisions(batch.obs.mask, batch.act, batch.rew,
                           [batch.info[key] for key in ("duration", "discount", "discounted_reward")])
    with policy_within_training_step(policy):
        loss = algorithm.update(buffer, sample_size=32).loss
    assert np.isfinite(loss)
    return f"{told}; loss of an update {loss:.3g}; {train_tianshou()}"


def check_rllib() -> str:
    """Its action-masking module under its environment runner, in this process: no cluster is started."""
    from ray.rllib.algorithms.ppo import PPOConfig
    from ray.rllib.core.rl_module.rl_module import RLModuleSpec
    from ray.rllib.env.single_agent_env_runner import SingleAgentEnvRunner
    from ray.rllib.examples.rl_modules.classes.action_masking_rlm import ActionMaskingTorchRLModule
    from ray.tune.registry import register_env

    register_env("room", lambda config: make_room())
    module = RLModuleSpec(module_class=ActionMaskingTorchRLModule, model_config={"fcnet_hiddens": [16]})
    config = (PPOConfig().environment("room").env_runners(num_env_runners=0, num_envs_per_env_runner=1)
              .debugging(seed=0).rl_module(rl_module_spec=module))
    episodes = SingleAgentEnvRunner(config=config).sample(num_timesteps=200, random_actions=False)
    masks = np.concatenate([episode.get_observations()["action_mask"][:-1] for episode in episodes])
    actions = np.concatenate([episode.get_actions() for episode in episodes])
    rewards = np.concatenate([episode.get_rewards() for episode in episodes])
    infos = [info for episode in episodes for info in episode.get_infos()[1:]]
    return check_decisions(masks, actions, rewards, [
        [info[key] for info in infos] for key in ("duration", "discount", "discounted_reward")])


def check_minari() -> str:
    """Its collector, which records `info`, and the data set that it makes."""
    import minari

    with tempfile.TemporaryDirectory() as folder:
        os.environ["MINARI_DATASETS_PATH"] = folder
        env = minari.DataCollector(make_room(), record_infos=True)
        rng = np.random.default_rng(0)
        for seed in range(30):
            seen, _ = env.reset(seed=seed)
            over = False
            while not over:
                seen, _, terminated, truncated, _ = env.step(int(rng.choice(np.flatnonzero(seen["action_mask"]))))
                over = terminated or truncated
        episodes = list(env.create_dataset("options/check-v0", algorithm_name="random"))
        assert len(episodes) == 30
        infos = [np.concatenate([each.infos[key][1:] for each in episodes])
                 for key in ("duration", "discount", "discounted_reward")]
        masks = np.concatenate([each.infos["action_mask"][:-1] for each in episodes])
        return check_decisions(masks, np.concatenate([each.actions for each in episodes]),
                               np.concatenate([each.rewards for each in episodes]), infos)


def check_ale() -> str:
    """Options over Breakout's memory: the paddle follows the ball, byte 72 and byte 99."""
    import ale_py

    gymnasium.register_envs(ale_py)
    fire, right, left = 1, 2, 3
    skills = [
        Skill("follow", lambda ram: right if ram[99] > ram[72] else left, lambda ram: ram[101] == 0),
        Skill("to-the-left", lambda ram: left, lambda ram: ram[72] < 70, lambda ram: ram[72] >= 70),
        Skill("serve", lambda ram: fire, lambda ram: ram[101] != 0, lambda ram: ram[101] == 0),
        Skill("wait", lambda ram: 0, lambda ram: ram[101] == 0, lambda ram: ram[101] != 0),
    ]
    replayed = compare_with_copy(
        lambda: gymnasium.make("ALE/Breakout-v5", obs_type="ram", max_episode_steps=300), skills, decisions=300)
    assert replayed.longest > 20 and replayed.terminated and replayed.truncated and replayed.masked, replayed
    return str(replayed)


def check_point_maze() -> str:
    """Options over forces and observations with goals, in episodes that end at the goal."""
    import gymnasium_robotics

    gymnasium.register_envs(gymnasium_robotics)

    def head(seen: Any) -> Any:
        return np.clip(10 * (seen["desired_goal"] - seen["achieved_goal"]) - seen["observation"][2:], -1, 1)

    def is_slow(seen: Any) -> bool:
        return float(np.abs(seen["observation"][2:]).max()) < 0.1

    skills = [
        Skill("to-the-goal", head, lambda seen: False),
        Skill("east", lambda seen: [1.0, 0.0], lambda seen: seen["observation"][2] > 0.8),
        Skill("north", lambda seen: [0.0, 1.0], lambda seen: seen["observation"][3] > 0.8),
        Skill("brake", lambda seen: np.clip(-2 * seen["observation"][2:], -1, 1), is_slow,
              lambda seen: not is_slow(seen)),
    ]
    found = []
    for name in ("PointMaze_OpenDense-v3", "PointMaze_UMaze-v3"):  # the wall of the second keeps the ball from its goal
        found.append(compare_with_copy(
            lambda name=name: gymnasium.make(name, continuing_task=False, max_episode_steps=100), skills, decisions=60))
    assert found[0].terminated and found[1].truncated, found
    assert all(each.longest > 20 and each.masked for each in found), found
    return "; ".join(map(str, found))


class Library(NamedTuple):
    """A library: the requirements of its environment, in the order of their installation, and its check."""

    requirements: tuple[str, ...]
    check: Callable[[], str]


LIBRARIES = {
    "tianshou": Library(("tianshou==2.0.1",), check_tianshou),
    "rllib": Library(("ray[rllib]==2.60.0",), check_rllib),  # which then replaces Gymnasium by the version that it pins
    "minari": Library(("minari[create,hdf5]==0.5.4",), check_minari),
    "ale": Library(("ale-py==0.12.1",), check_ale),
    "point-maze": Library(("gymnasium-robotics==1.4.2",), check_point_maze),
}


def run_apart(name: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """Run a check in a virtual environment of its own, which is made first where the folder has none.

    Args:
        name: of the library.
        folder: of the environment.

    Raises:
        subprocess.CalledProcessError: the library cannot be installed.
    """
    python = folder / "bin/python"
    if not (folder / "complete").exists():
        subprocess.run([sys.executable, "-m", "venv", "--clear", folder], check=True)
        install = [python, "-m", "pip", "install", "--quiet", "--no-compile", TORCH]
        for requirements in (("-e", str(ROOT)), LIBRARIES[name].requirements):
            subprocess.run([*install, *requirements], check=True)
        (folder / "complete").touch()
    kept = {key: value for key, value in os.environ.items() if key not in ("PYTHONPATH", "PYTHONHOME")}
    return subprocess.run([python, "-m", "benchmarks.third_party", name, "--here"], cwd=ROOT, env=kept, text=True,
                          stdout=subprocess.PIPE, stderr=subprocess.STDOUT)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns 1 where a check fails."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", help=f"libraries ({', '.join(LIBRARIES)}; all by default)")
    parser.add_argument("--folder", type=Path, help="folder for the virtual environments; by default a temporary one")
    parser.add_argument("--here", action="store_true", help="run the check in this interpreter")
    chosen = parser.parse_args(arguments)
    if unknown := set(chosen.names) - set(LIBRARIES):
        parser.error(f"no such library: {', '.join(sorted(unknown))}. Known: {', '.join(LIBRARIES)}")
    good = True
    for name in chosen.names or LIBRARIES:
        if chosen.here:
            print(f"{name}: {LIBRARIES[name].check()}")
            continue
        with tempfile.TemporaryDirectory() as temporary:
            done = run_apart(name, (chosen.folder or Path(temporary)).resolve() / name)
        good &= done.returncode == 0
        told = [line for line in done.stdout.splitlines() if line.startswith(f"{name}: ")]
        print(told[-1] if told and not done.returncode else f"{name}: FAILED\n{done.stdout}", flush=True)
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
