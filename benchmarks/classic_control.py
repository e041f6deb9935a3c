"""Tasks of Gymnasium with known answers: does an agent solve them, and does it still solve them when its budget ends?

    python -m benchmarks.classic_control                       # all tasks and contenders, ten seeds: hours on a core
    python -m benchmarks.classic_control --tasks CartPole-v1   # one task
    python -m benchmarks.classic_control --quick               # seconds: shows that everything runs

Agents run at their default settings, `dqn-tuned` at settings chosen for the task on seeds 500 to 504, `sb3-dqn` and
`sb3-ppo` (Stable-Baselines3) at the settings of RL Baselines3 Zoo, all for the same number of primitives. `final` is
the mean return of the greedy policy at the end of the budget, and `best` its best evaluation on the way: reaching a
threshold is not holding it. Comparisons are paired by seed. Finished runs are kept, a line each, in the file `--out`;
the command continues a stopped run.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import torch
from numpy.typing import NDArray

from hrl_escape.agents import evaluate, make_agent
from hrl_escape.agents.agent import Agent, FixedPolicy, count_actions, make_transition
from hrl_escape.agents.single_env import serve_one
from hrl_escape.benchmark.inference import compare_pairs, correct_by_holm
from hrl_escape.benchmark.statistics import compute_iqm
from studies.statistics import compute_sign_flip_p

EPISODES = 20
"""Greedy episodes in an evaluation, the same ones for every contender and seed."""
EVALUATIONS = 8
"""Evaluations in a run, evenly spaced, the last at its end."""


@dataclass(frozen=True)
class Task:
    """An environment, a budget, and what `dqn` and Stable-Baselines3's agents were tuned to for it.

    Attributes:
        primitives: budget of a run.
        threshold: smallest mean return of a solved task.
        tuned: arguments of `stable_baselines3.DQN`, from RL Baselines3 Zoo's `hyperparams/dqn.yml`.
        settings: of `dqn-tuned`, where they are not the defaults.
        ppo: arguments of `stable_baselines3.PPO`, from the Zoo's `hyperparams/ppo.yml`; rates and clips fall to 0.
        environments: that PPO steps at once.
        normalises: PPO sees observations and rewards normalised by their running moments.
    """

    primitives: int
    threshold: float
    tuned: dict[str, Any]
    settings: dict[str, Any] = field(default_factory=dict)
    ppo: dict[str, Any] = field(default_factory=dict)
    environments: int = 1
    normalises: bool = False


_WIDE = {"policy_kwargs": {"net_arch": [256, 256]}, "gamma": 0.99}
_LONG = {"learning_rate": 6.3e-4, "batch_size": 128, "buffer_size": 50_000, "learning_starts": 0,
         "target_update_interval": 250, "train_freq": 4, "gradient_steps": -1, "exploration_fraction": 0.12,
         "exploration_final_eps": 0.1, **_WIDE}
_RAW = {"scale_observations": False, "updates_per_step": 1.0}
TASKS = {
    "CartPole-v1": Task(40_000, 475.0, {
        "learning_rate": 2.3e-3, "batch_size": 64, "buffer_size": 100_000, "learning_starts": 1_000,
        "target_update_interval": 10, "train_freq": 256, "gradient_steps": 128, "exploration_fraction": 0.16,
        "exploration_final_eps": 0.04, **_WIDE,
    }, ppo={"n_steps": 32, "batch_size": 256, "gae_lambda": 0.8, "gamma": 0.98, "n_epochs": 20,
            "learning_rate": lambda left: 1e-3 * left, "clip_range": lambda left: 0.2 * left}, environments=8),
    "Acrobot-v1": Task(30_000, -100.0, _LONG, _RAW, ppo={"n_steps": 256, "gae_lambda": 0.94, "n_epochs": 4},
                       environments=16, normalises=True),
    "LunarLander-v3": Task(25_000, 200.0, _LONG, _RAW),
}
Trainer = Callable[[str, Task, int, int], Iterator[tuple[int, float]]]
"""From task, its settings, seed and budget to pairs (primitives, mean return of an evaluation)."""


class Peer(FixedPolicy):
    """The greedy policy of a model of Stable-Baselines3, as `evaluate` needs it."""

    def __init__(self, model: Any) -> None:
        self._model = model
        self._normalise = getattr(getattr(model, "env", None), "normalize_obs", lambda observation: observation)

    def act(self, observation: Any, action_mask: NDArray[np.bool_]) -> int:
        """The likeliest action."""
        return int(self._model.predict(self._normalise(observation), deterministic=True)[0])


def measure(agent: Any, env: gymnasium.Env) -> float:
    """Mean return of a greedy policy."""
    return evaluate(agent, env, EPISODES, seed=0).mean_return


def train_agent(name: str, is_tuned: bool = False) -> Trainer:
    """A trainer of one of our agents at its default settings, or at those that were tuned for the task."""

    def run(task_id: str, task: Task, seed: int, budget: int) -> Iterator[tuple[int, float]]:
        env, eval_env = gymnasium.make(task_id), gymnasium.make(task_id)
        agent: Agent = make_agent(name, env.observation_space, env.action_space, seed,
                                  **task.settings if is_tuned else {})
        served, (observation, _) = serve_one(agent), env.reset(seed=seed)
        mask = np.ones(count_actions(env.action_space, name), np.bool_)
        for primitives in range(1, budget + 1):
            action = served.act(observation, mask)
            transition = make_transition(observation, action, mask, env.step(action), agent.gamma)
            served.observe(transition)
            observation = transition.next_observation
            if transition.terminated or transition.truncated:
                observation, _ = env.reset()
            if primitives % (budget // EVALUATIONS) == 0:
                yield primitives, measure(agent, eval_env)

    return run


def train_peer(name: str) -> Trainer:
    """A trainer of Stable-Baselines3's DQN or PPO at the settings tuned for the task."""

    def run(task_id: str, task: Task, seed: int, budget: int) -> Iterator[tuple[int, float]]:
        import stable_baselines3
        from stable_baselines3.common.callbacks import BaseCallback
        from stable_baselines3.common.env_util import make_vec_env
        from stable_baselines3.common.vec_env import VecNormalize

        eval_env, scores = gymnasium.make(task_id), list[tuple[int, float]]()

        class Evaluate(BaseCallback):
            def _on_step(self) -> bool:
                if self.num_timesteps >= (len(scores) + 1) * (budget // EVALUATIONS):
                    scores.append((self.num_timesteps, measure(Peer(self.model), eval_env)))
                return len(scores) < EVALUATIONS

        if name == "dqn":
            env, settings = gymnasium.make(task_id), task.tuned
        else:
            env, settings = make_vec_env(task_id, task.environments, seed=seed), task.ppo
            env = VecNormalize(env) if task.normalises else env
        model = getattr(stable_baselines3, name.upper())("MlpPolicy", env, seed=seed, device="cpu", **settings)
        model.learn(budget, callback=Evaluate())
        yield from scores

    return run


CONTENDERS: dict[str, Trainer] = {name: train_agent(name) for name in ("dqn", "rainbow", "ppo", "dac", "ppoc")} | {
    "dqn-tuned": train_agent("dqn", is_tuned=True), "sb3-dqn": train_peer("dqn"), "sb3-ppo": train_peer("ppo")}
PAIRS = (("dqn", "sb3-dqn"), ("rainbow", "sb3-dqn"), ("rainbow", "dqn"), ("dqn-tuned", "sb3-dqn"), ("dqn-tuned", "dqn"),
         ("ppo", "sb3-ppo"))
"""Contenders that are compared seed by seed."""


def summarise(rows: Sequence[dict[str, Any]]) -> str:
    """A table with a line for each task and contender.

    Args:
        rows: finished runs.
    """
    lines = ["| task | contender | runs | final, mean | 95 % interval | best, mean | final at the threshold |",
             "|---|---|---|---|---|---|---|"]
    for task_id, task in TASKS.items():
        for name in CONTENDERS:
            scores = [row["scores"] for row in rows if (row["task"], row["contender"]) == (task_id, name)]
            if not scores:
                continue
            final, best = np.array([run[-1][1] for run in scores]), np.array([max(s for _, s in run) for run in scores])
            draws = np.random.default_rng(0).integers(len(final), size=(10_000, len(final)))
            low, high = np.percentile(final[draws].mean(axis=1), (2.5, 97.5))
            held = f"{(final >= task.threshold).sum()} of {len(final)}"
            lines.append(f"| {task_id} | {name} | {len(final)} | {final.mean():.0f} | {low:.0f} to {high:.0f} | "
                         f"{best.mean():.0f} | {held} |")
    return "\n".join(lines)


def compare(rows: Sequence[dict[str, Any]]) -> str:
    """A table of differences between the final returns of two contenders with the same seed.

    `all` is the mean over a run's evaluations, which shows earlier learning. Each difference has Student's interval
    and the test of signs; the verdict distinguishes two contenders if Holm's correction over all rows leaves p below
    0.05.

    Args:
        rows: finished runs; a pair has those seeds that both contenders ran.
    """
    found = []
    for task_id in TASKS:
        for pair in PAIRS:
            runs = [{row["seed"]: [score for _, score in row["scores"]] for row in rows
                     if (row["task"], row["contender"]) == (task_id, name)} for name in pair]
            seeds = sorted(runs[0].keys() & runs[1].keys())
            if len(seeds) > 1:
                final, best, whole = (np.array([[pick(of[seed]) for seed in seeds] for of in runs])
                                      for pick in (lambda scores: scores[-1], max, np.mean))
                p = min(1.0, *(2 * compute_sign_flip_p(final[0] - final[1], side) for side in ("above", "below")))
                found.append((task_id, pair, final, best, whole, p))
    lines = ["| task | first, second | pairs | final, IQM | best, IQM | all, IQM | difference of final, mean "
             "| 95 % interval | p, Holm | verdict |", "|---|---|---|---|---|---|---|---|---|---|"]
    for (task_id, pair, *measures, _), p in zip(found, correct_by_holm([each[-1] for each in found]), strict=True):
        test = compare_pairs([measures[0][0] - measures[0][1]])
        side = "better" if test.difference > 0 else "worse"
        verdict = "no significant difference" if p >= 0.05 else f"{pair[0]} {side}"
        middles = " | ".join(f"{compute_iqm([of[0]]):.0f}, {compute_iqm([of[1]]):.0f}" for of in measures)
        lines.append(f"| {task_id} | {', '.join(pair)} | {test.pairs} | {middles} | {test.difference:+.0f} | "
                     f"{test.low:+.0f} to {test.high:+.0f} | {p:.3f} | {verdict} |")
    return "\n".join(lines) if found else ""


def find_budget(task: Task, arguments: argparse.Namespace) -> int:
    """Primitives of a run."""
    return arguments.primitives or task.primitives // (50 if arguments.quick else 1)


def main() -> None:
    """Run what is missing, then print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tasks", nargs="+", choices=TASKS, default=list(TASKS))
    parser.add_argument("--contenders", nargs="+", choices=CONTENDERS, default=list(CONTENDERS))
    parser.add_argument("--seeds", nargs="+", type=int, default=list(range(10)))
    parser.add_argument("--out", type=Path, default=Path("classic_control.jsonl"), help="where finished runs are kept")
    parser.add_argument("--primitives", type=int, help="budget of a run, instead of the task's")
    parser.add_argument("--quick", action="store_true", help="a fiftieth of each budget, one seed")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    rows = [json.loads(line) for line in arguments.out.read_text().splitlines()] if arguments.out.exists() else []
    wanted = [(task, name, seed) for seed in arguments.seeds[: 1 if arguments.quick else None]
              for task in arguments.tasks for name in arguments.contenders]
    for task_id, name, seed in wanted:
        task = TASKS[task_id]
        budget = find_budget(task, arguments)
        run = {"task": task_id, "contender": name, "seed": seed, "primitives": budget}
        if any(row.items() >= run.items() for row in rows):
            continue
        started = time.perf_counter()
        run |= {"scores": list(CONTENDERS[name](task_id, task, seed, budget))}
        rows.append(run | {"seconds": round(time.perf_counter() - started, 1)})
        with arguments.out.open("a") as file:
            file.write(json.dumps(rows[-1]) + "\n")
        print(f"{name} on {task_id}, seed {seed}: {run['scores'][-1][1]:.1f} at the end", flush=True)
    budgets = {(each, find_budget(TASKS[each], arguments)) for each in arguments.tasks}
    rows = [row for row in rows if (row["task"], row["primitives"]) in budgets and row["seed"] in arguments.seeds]
    print(summarise(rows), compare(rows), sep="\n\n")


if __name__ == "__main__":
    main()
