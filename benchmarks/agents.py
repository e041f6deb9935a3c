"""Measure updates per second of the deep agents against Stable-Baselines3 and TorchRL.

An update is a sample from replay (or a minibatch of a rollout), a gradient step, and the target
network's step. All contenders have two hidden layers of 64 units and batches of 64, for 12 inputs
and 9 actions, on one core. They take turns in one run, so that other work on the machine slows all
of them alike; the median of the rounds is printed.

Examples:
    python -m benchmarks.agents
    python -m benchmarks.agents --compile --json
"""

from __future__ import annotations

import dataclasses
import json
import logging
import statistics
import sys
import time
from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
import torch
from rich.console import Console
from rich.table import Table
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
from torchrl.modules import MLP, QValueActor
from torchrl.objectives import DQNLoss, SoftUpdate, ValueEstimators

from hrl_escape.agents import make_agent
from hrl_escape.agents.agent import SMDPTransition
from hrl_escape.agents.single_env import serve_one
from hrl_escape.cli import run_script
from hrl_escape.errors import MissingExtraError

INPUTS, ACTIONS, HIDDEN, BATCH, STORED = 12, 9, (64, 64), 64, 10_000
ROLLOUT, EPOCHS = 256, 10


class RandomSteps(gymnasium.Env):
    """Environment of random observations that costs next to nothing to step."""

    observation_space = gymnasium.spaces.Box(-1, 1, (INPUTS,), np.float32)
    action_space = gymnasium.spaces.Discrete(ACTIONS)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin an episode."""
        super().reset(seed=seed)
        return self._draw(), {}

    def step(self, action: int) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Draw the next observation."""
        return self._draw(), -1.0, bool(self.np_random.random() < 0.01), False, {}

    def _draw(self) -> Any:
        return self.np_random.standard_normal(INPUTS, dtype=np.float32)


def make_ours(name: str) -> Callable[[int], None]:
    """Update of one of our agents from replay, as `observe` calls it."""
    env = RandomSteps()
    fast = {"hidden": HIDDEN, "batch_size": BATCH, "updates_per_step": 0.0, "warmup": 0}
    agent: Any = make_agent(name, env.observation_space, env.action_space, 0, **fast)
    served = serve_one(agent)
    for transition in draw_transitions(STORED):
        served.observe(transition)
    agent._steps = 10**6  # past every warm-up

    def update(count: int) -> None:
        for _ in range(count):
            agent.update(agent.replay.sample(BATCH))

    return update


def make_our_ppo() -> Callable[[int], None]:
    """Updates of our PPO from a rollout."""
    env = RandomSteps()
    agent: Any = make_agent(
        "ppo", env.observation_space, env.action_space, 0, hidden=HIDDEN, rollout=ROLLOUT, epochs=EPOCHS
    )
    rollout, served = draw_transitions(ROLLOUT), serve_one(agent)

    def update(count: int) -> None:
        for _ in range(count * BATCH // (ROLLOUT * EPOCHS)):
            for transition in rollout:
                served.observe(transition)

    return update


def draw_transitions(count: int) -> list[SMDPTransition]:
    """Random decisions of 1 to 20 primitives."""
    rng, mask = np.random.default_rng(0), np.ones(ACTIONS, np.bool_)
    transitions = []
    for _ in range(count):
        here, there = rng.standard_normal((2, INPUTS)).astype(np.float32)
        k = int(rng.integers(1, 21))
        over = bool(rng.random() < 0.01)
        action = int(rng.integers(ACTIONS))
        transitions.append(SMDPTransition(here, action, mask, -1.0 * k, -1.0 * k, k, 0.99**k, there, mask, over, False))
    return transitions


def make_torchrl(compiled: bool) -> Callable[[int], None]:
    """The same double DQN, built from TorchRL's parts."""
    actor = QValueActor(
        TensorDictModule(
            MLP(in_features=INPUTS, out_features=ACTIONS, num_cells=HIDDEN, activation_class=torch.nn.ReLU),
            in_keys=["observation"],
            out_keys=["action_value"],
        ),
        spec=None,
        action_space="categorical",
        action_mask_key="action_mask",
    )
    loss = DQNLoss(actor, loss_function="smooth_l1", double_dqn=True, delay_value=True, action_space="categorical")
    loss.make_value_estimator(ValueEstimators.TD0, gamma=0.99)
    target = SoftUpdate(loss, tau=0.01)
    parameters = list(loss.parameters())
    optimiser = torch.optim.Adam(parameters, 1e-3, fused=True)
    replay = TensorDictReplayBuffer(storage=LazyTensorStorage(STORED), batch_size=BATCH)
    transitions = draw_transitions(STORED)

    def stack(name: str, dtype: torch.dtype) -> torch.Tensor:
        return torch.from_numpy(np.array([getattr(t, name) for t in transitions])).to(dtype)

    replay.extend(
        TensorDict(
            {
                "observation": stack("observation", torch.float32),
                "action_mask": stack("action_mask", torch.bool),
                "action": stack("action", torch.int64),
                "steps_to_next_obs": stack("duration", torch.int64)[:, None],
                "next": {
                    "observation": stack("next_observation", torch.float32),
                    "action_mask": stack("next_action_mask", torch.bool),
                    "reward": stack("reward", torch.float32)[:, None],
                    "terminated": stack("terminated", torch.bool)[:, None],
                    "done": stack("terminated", torch.bool)[:, None],
                },
            },
            [STORED],
        )
    )
    compute = torch.compile(loss) if compiled else loss

    def update(count: int) -> None:
        for _ in range(count):
            value = compute(replay.sample())["loss"]
            optimiser.zero_grad()
            value.backward()
            torch.nn.utils.clip_grad_norm_(parameters, 10.0)
            optimiser.step()
            target.step()
            value.item()

    return update


def make_sb3_dqn() -> Callable[[int], None]:
    """DQN of Stable-Baselines3 (not double), with its own replay and train()."""
    model = _load_stable_baselines().DQN(
        "MlpPolicy", RandomSteps(), batch_size=BATCH, buffer_size=STORED, learning_starts=STORED - 1, seed=0,
        policy_kwargs={"net_arch": list(HIDDEN)}, device="cpu", target_update_interval=1, tau=0.01,
    )  # fmt: skip
    model.learn(STORED - 1)

    def update(count: int) -> None:
        for _ in range(count):
            model.train(gradient_steps=1, batch_size=BATCH)
            model._on_step()  # moves the target network

    return update


def make_sb3_ppo() -> Callable[[int], None]:
    """PPO of Stable-Baselines3: train() on a rollout."""
    model = _load_stable_baselines().PPO(
        "MlpPolicy", RandomSteps(), n_steps=ROLLOUT, batch_size=BATCH, n_epochs=EPOCHS, seed=0,
        policy_kwargs={"net_arch": list(HIDDEN)}, device="cpu", ent_coef=0.01,
    )  # fmt: skip
    model.learn(ROLLOUT)

    def update(count: int) -> None:
        for _ in range(count * BATCH // (ROLLOUT * EPOCHS)):
            model.train()

    return update


def measure_updates(contenders: dict[str, Callable[[int], None]], updates: int, rounds: int) -> dict[str, float]:
    """Return the median updates per second of each contender over rounds; contenders alternate in a round."""
    rates: dict[str, list[float]] = {name: [] for name in contenders}
    for update in contenders.values():
        update(80)
    for _ in range(rounds):
        for name, update in contenders.items():
            started = time.perf_counter()
            update(updates)
            rates[name].append(updates / (time.perf_counter() - started))
    return {name: statistics.median(values) for name, values in rates.items()}


@dataclasses.dataclass(frozen=True)
class Args:
    """Options of the command line."""

    updates: int = 400
    """Updates in a round."""
    rounds: int = 7
    """Number of rounds."""
    compile: bool = False
    """Also measure TorchRL's loss compiled, which takes about 20 s more."""
    json: bool = False
    """Print JSON instead of a table."""


def run(args: Args) -> int:
    """Measure and print; ratios are to Stable-Baselines3's agent of the same kind."""
    torch.set_num_threads(1)
    logging.getLogger("torchrl").setLevel(logging.WARNING)  # it prints a line for every buffer
    contenders = {
        "dqn": make_ours("dqn"),
        "Stable-Baselines3 DQN": make_sb3_dqn(),
        "TorchRL DQNLoss": make_torchrl(compiled=False),
        "sarsa": make_ours("sarsa"),
        "ddpg (critic and actor)": make_ours("ddpg"),
        "ppo": make_our_ppo(),
        "Stable-Baselines3 PPO": make_sb3_ppo(),
    }
    if args.compile:
        contenders["TorchRL DQNLoss, compiled"] = make_torchrl(compiled=True)
    rates = measure_updates(contenders, args.updates, args.rounds)
    rows = {}
    for name, rate in rates.items():
        theirs = rates["Stable-Baselines3 PPO" if "ppo" in name.lower() else "Stable-Baselines3 DQN"]
        rows[name] = {"updates_per_second": round(rate, 1), "ratio": round(rate / theirs, 3)}
    if args.json:
        print(json.dumps(rows, indent=2))
        return 0
    title = "Updates on one core, medians of one run"
    table = Table("agent", "updates a second", "to Stable-Baselines3's", title=title)
    for name, row in rows.items():
        table.add_row(name, f"{row['updates_per_second']:,.0f}", f"{row['ratio']:.2f}")
    Console().print(table)
    return 0


def _load_stable_baselines() -> Any:
    try:
        import stable_baselines3
    except ImportError:
        raise MissingExtraError("stable-baselines3", "bench", "python -m benchmarks.agents") from None
    return stable_baselines3


if __name__ == "__main__":
    sys.exit(run_script(run))
