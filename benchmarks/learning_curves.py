"""Does an agent learn the same from many environments as from one, after equally many primitives?

    python -m benchmarks.learning_curves                       # all tasks, ten seeds: some 30 minutes of a core
    python -m benchmarks.learning_curves --tasks CartPole-v1   # one task
    python -m benchmarks.learning_curves --quick               # seconds: shows that everything runs

`defaults` is our agent at its default settings, with one environment the ordinary way. The other variants change how
long a rollout of many environments is, and into how large minibatches it is cut. `sb3` is Stable-Baselines3's PPO at
its defaults, `sb3-zoo` at those that RL Baselines3 Zoo tuned for the task. All are evaluated after the same numbers of
primitives, of all environments together, in the same greedy episodes. Comparisons are paired by seed. Finished runs are
kept, a line each, in the file `--out`; the command continues a stopped run.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium
import numpy as np
import torch

from benchmarks.classic_control import Peer
from hrl_escape.agents import evaluate, make_agent
from hrl_escape.agents.agent import Agent, count_actions, make_transition, read_action_mask
from hrl_escape.agents.decisions import Moments
from hrl_escape.agents.many_envs import gather_decisions
from hrl_escape.agents.single_env import serve_many, serve_one
from hrl_escape.agents.training.evaluation import compute_episode_seed
from hrl_escape.agents.training.many_envs import make_many_envs
from hrl_escape.benchmark.inference import PairedTest, compare_pairs, correct_by_holm

EVALUATIONS = 8
"""Evaluations in a run, evenly spaced, the last at its end."""
SURE = 0.05
"""Corrected p-value below which a difference is called one."""
OPTIONS = "hrl_escape/PaperTwoButtonOptions-v1"
PEER_NUMBER, MOST = 8, 512
"""Environments of Stable-Baselines3's PPO, and most of ours."""
LONGEST = 2_048
"""Decisions of a rollout at the recommended settings for more than 64 environments."""


@dataclass(frozen=True)
class Task:
    """An environment, and how it is learned.

    Attributes:
        agent: name of ours.
        primitives: budget of a run, of all environments together.
        arguments: of the environment.
        vector_arguments: further ones of many environments.
        zoo: arguments of `stable_baselines3.PPO` for 8 environments, from RL Baselines3 Zoo's `hyperparams/ppo.yml`.
        has_peer: Stable-Baselines3 can learn it, which knows no decisions of several primitives.
        variants: of our agent's settings, in addition to the defaults.
        episodes: greedy ones in an evaluation, the same in every run.
        numbers: of environments.
    """

    agent: str
    primitives: int
    arguments: dict[str, Any] = field(default_factory=dict)
    vector_arguments: dict[str, Any] = field(default_factory=dict)
    zoo: dict[str, Any] | None = None
    has_peer: bool = True
    variants: tuple[str, ...] = ("short rollouts", "small minibatches", "both")
    episodes: int = 5
    numbers: tuple[int, ...] = (1, 8, 64, MOST)


TASKS = {
    "CartPole-v1": Task("ppo", 40_960, zoo={
        "n_steps": 32, "batch_size": 256, "gae_lambda": 0.8, "gamma": 0.98, "n_epochs": 20, "ent_coef": 0.0,
        "learning_rate": lambda left: 1e-3 * left, "clip_range": lambda left: 0.2 * left}),
    OPTIONS: Task("smdp-ppo+primitives", 81_920, {"observation": "features"}, {"output": "torch"}, has_peer=False,
                  variants=("both",), episodes=1, numbers=(1, 64, MOST)),  # all of its episodes begin alike
    "Acrobot-v1": Task("ppo", 40_960, vector_arguments={"vectorization_mode": "sync"}, variants=("both",)),
}
VARIANTS: dict[str, Callable[[int], dict[str, Any]]] = {
    "defaults": lambda count: {},
    "short rollouts": lambda count: {"rollout_per_env": max(1, LONGEST // count)},
    "small minibatches": lambda count: {"rollout": 32 * count},
    "both": lambda count: {"rollout_per_env": max(1, LONGEST // count), "rollout": LONGEST},
}
"""Settings for a number of environments; a minibatch is of 64 decisions where a rollout has no more than `rollout`."""


class Contender(NamedTuple):
    """A learner, and its number of environments."""

    name: str
    number: int

    def __str__(self) -> str:
        return f"`{self.name}` with {self.number}"


ONE = Contender("defaults", 1)
PAIRS = (*((Contender("defaults", count), ONE) for count in (8, 64, MOST)),
         *((Contender(name, MOST), Contender("defaults", MOST)) for name in VARIANTS if name != "defaults"),
         (Contender("short rollouts", MOST), Contender("defaults", 64)), (Contender("both", MOST), ONE),
         *((Contender("defaults", PEER_NUMBER), Contender(name, PEER_NUMBER)) for name in ("sb3", "sb3-zoo")))
"""Contenders that are compared seed by seed. Short rollouts of many environments are as large as of 64 at the
defaults, and cut alike: they differ in how far an environment is followed."""
EVERY = tuple(dict.fromkeys(contender for pair in PAIRS for contender in reversed(pair)))
Score = Callable[[Any], float]


def list_contenders(task: Task) -> list[Contender]:
    """Contenders of a task, each once."""
    names = ["defaults", *task.variants, *(["sb3"] if task.has_peer else []), *(["sb3-zoo"] if task.zoo else [])]
    return [contender for contender in EVERY if contender.name in names and contender.number in task.numbers]


# --- learning --------------------------------------------------------------------------


class Marks:
    """Evaluates an agent when it passes a mark.

    Args:
        marks: numbers of primitives before each evaluation.
        score: evaluates.

    Attributes:
        scores: (mark, score) so far.
    """

    def __init__(self, marks: Sequence[int], score: Score) -> None:
        self._marks, self._score = marks, score
        self.scores: list[tuple[int, float]] = []

    @property
    def is_over(self) -> bool:
        """True after the last mark."""
        return len(self.scores) == len(self._marks)

    def reach(self, primitives: int, learner: Any) -> None:
        """Evaluate if the number of primitives passes a mark."""
        while not self.is_over and primitives >= self._marks[len(self.scores)]:
            self.scores.append((self._marks[len(self.scores)], self._score(learner)))


def train_in_one(agent: Any, env: gymnasium.Env, seed: int, marks: Marks) -> None:
    """Train in one environment, the ordinary way."""
    served = serve_one(agent)
    primitives = episode = 0
    while not marks.is_over:
        observation, info = env.reset(seed=compute_episode_seed(seed, "training", episode))
        mask, is_over, episode = read_action_mask(info, count_actions(env.action_space, "ppo")), False, episode + 1
        while not (is_over or marks.is_over):
            action = served.act(observation, mask)
            transition = make_transition(observation, action, mask, env.step(action), agent.gamma)
            served.observe(transition)
            primitives += transition.duration
            marks.reach(primitives, agent)
            observation, mask = transition.next_observation, transition.next_action_mask
            is_over = transition.terminated or transition.truncated


def train_in_many(agent: Agent, env: Any, seed: int, marks: Marks) -> None:
    """Train in a vector environment."""
    streams = make_many_envs(env, agent.gamma)
    streams.reset(compute_episode_seed(seed, "streams", 1))
    served, masks, primitives = serve_many(agent), streams.action_mask.clone(), 0
    served.begin_episodes(streams.count, streams.device)
    while not marks.is_over:
        asking = streams.is_waiting.nonzero().squeeze(1)
        action = torch.zeros(streams.count, dtype=torch.int64)
        masks[asking] = streams.action_mask[asking]
        action[asking] = served.act(Moments(asking, streams.observation[asking], masks[asking]))
        decisions = gather_decisions(streams.step(action), masks, streams.gamma, agent.gamma)
        served.observe(decisions)
        primitives += int(decisions.duration.sum())
        marks.reach(primitives, agent)


def train_peer(task_id: str, settings: dict[str, Any], seed: int, budget: int, marks: Marks) -> None:
    """Train Stable-Baselines3's PPO in a vector environment."""
    from stable_baselines3 import PPO
    from stable_baselines3.common.callbacks import BaseCallback
    from stable_baselines3.common.env_util import make_vec_env

    class Evaluate(BaseCallback):
        def _on_step(self) -> bool:
            marks.reach(self.num_timesteps, Peer(self.model))
            return not marks.is_over

    env = make_vec_env(task_id, n_envs=PEER_NUMBER, seed=compute_episode_seed(seed, "streams", 1) % 2**31)
    PPO("MlpPolicy", env, seed=seed, device="cpu", **settings).learn(budget, callback=Evaluate())


def execute(task_id: str, contender: Contender, seed: int, budget: int) -> list[tuple[int, float]]:
    """Pairs (primitives, mean return of an evaluation) of a run."""
    task, (name, count) = TASKS[task_id], contender
    eval_env = gymnasium.make(task_id, **task.arguments)
    marks = Marks([budget * (number + 1) // EVALUATIONS for number in range(EVALUATIONS)],
                  lambda learner: evaluate(learner, eval_env, task.episodes, seed=0).mean_return)
    if name.startswith("sb3"):
        train_peer(task_id, dict(task.zoo or {}) if name == "sb3-zoo" else {}, seed, budget, marks)
        return marks.scores
    agent: Any = make_agent(task.agent, eval_env.observation_space, eval_env.action_space, seed,
                            **VARIANTS[name](count))
    if count == 1:
        train_in_one(agent, gymnasium.make(task_id, **task.arguments), seed, marks)
    else:
        train_in_many(agent, gymnasium.make_vec(task_id, num_envs=count, **task.arguments, **task.vector_arguments),
                      seed, marks)
    return marks.scores


# --- what came of it -------------------------------------------------------------------


class Comparison(NamedTuple):
    """Two contenders, seed by seed: the mean return over all evaluations of a run, and of the last."""

    first: Contender
    second: Contender
    whole: PairedTest
    final: PairedTest


def compare(rows: Sequence[dict[str, Any]], pairs: Sequence[tuple[Contender, Contender]] = PAIRS) -> list[Comparison]:
    """Compare the contenders of one task; p-values are of Student's paired test, by Holm's correction over all of them.

    Args:
        rows: finished runs of the task; a pair has those seeds that both contenders ran.
        pairs: contenders to be compared.
    """
    found: list[tuple[tuple[Contender, Contender], list[PairedTest]]] = []
    for pair in pairs:
        runs = [{row["seed"]: [score for _, score in row["scores"]] for row in rows
                 if (row["contender"], row["count"]) == contender} for contender in pair]
        seeds = sorted(runs[0].keys() & runs[1].keys())
        if len(seeds) > 1:
            of = np.array([[run[seed] for seed in seeds] for run in runs])  # (2, seeds, evaluations)
            gaps = of[0] - of[1]
            found.append((pair, [compare_pairs([gap]) for gap in (gaps.mean(axis=1), gaps[:, -1])]))
    corrected = iter(correct_by_holm([test.p for _, tests in found for test in tests]))
    return [Comparison(*pair, *(test._replace(p=next(corrected)) for test in tests)) for pair, tests in found]


def describe(comparison: Comparison) -> str:
    """What a comparison shows, as a sentence."""
    first, second, whole, final = comparison
    if whole.p < SURE:
        says = f"{'more' if whole.difference > 0 else 'less'} than {second}, by {_describe_size(whole)} over the run"
        says = f"{first} learns {says}"
    else:
        says = f"Between {first} and {second} there is no significant difference over the run ({_describe_gap(whole)})"
    if final.p >= SURE:
        return f"{says}, nor at its end ({_describe_gap(final)})." if whole.p >= SURE else (
            f"{says}; at its end there is no significant difference ({_describe_gap(final)}).")
    where = "higher" if final.difference > 0 else "lower"
    return f"{says}; {'it' if whole.p < SURE else 'the first'} ends {_describe_size(final)} {where}."


def _describe_size(test: PairedTest) -> str:
    low, high = sorted((abs(test.low), abs(test.high)))
    return f"{abs(test.difference):.0f} ({low:.0f} to {high:.0f})"


def _describe_gap(test: PairedTest) -> str:
    return f"{test.difference:+.0f}, {test.low:+.0f} to {test.high:+.0f}"


def summarise(rows: Sequence[dict[str, Any]]) -> str:
    """A table with a line for each contender of one task.

    Args:
        rows: finished runs of the task.
    """
    lines = ["| contender | environments | runs | after 1/8 | 1/4 | 1/2 | all | over the run | processor seconds |",
             "|---|---|---|---|---|---|---|---|---|"]
    for contender in EVERY:
        own = [row for row in rows if (row["contender"], row["count"]) == contender]
        if own:
            scores = np.array([[score for _, score in row["scores"]] for row in own]).mean(axis=0)
            marks = " | ".join(f"{scores[len(scores) * part // 8 - 1]:.0f}" for part in (1, 2, 4, 8))
            seconds = np.mean([row["seconds"] for row in own])
            lines.append(f"| {contender.name} | {contender.number} | {len(own)} | {marks} | {scores.mean():.0f} | "
                         f"{seconds:.1f} |")
    return "\n".join(lines)


def main() -> None:
    """Run what is missing, then print tables and sentences."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tasks", nargs="+", choices=TASKS, default=list(TASKS))
    parser.add_argument("--seeds", nargs="+", type=int, default=list(range(10)))
    parser.add_argument("--out", type=Path, default=Path("learning_curves.jsonl"), help="where finished runs are kept")
    parser.add_argument("--quick", action="store_true", help="a fortieth of each budget, one seed")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    rows = [json.loads(line) for line in arguments.out.read_text().splitlines()] if arguments.out.exists() else []
    for task_id in arguments.tasks:
        task = TASKS[task_id]
        budget = task.primitives // (40 if arguments.quick else 1)
        for seed in arguments.seeds[: 1 if arguments.quick else None]:
            for contender in list_contenders(task):
                run = {"task": task_id, "contender": contender.name, "count": contender.number, "seed": seed,
                       "primitives": budget}
                if any(row.items() >= run.items() for row in rows):
                    continue
                started = time.process_time()
                run["scores"] = execute(task_id, contender, seed, budget)
                rows.append(run | {"seconds": round(time.process_time() - started, 1)})
                with arguments.out.open("a") as file:
                    file.write(json.dumps(rows[-1]) + "\n")
                print(f"{contender} on {task_id}, seed {seed}: {run['scores'][-1][1]:.1f} at the end", flush=True)
        own = [row for row in rows if (row["task"], row["primitives"]) == (task_id, budget)
               and row["seed"] in arguments.seeds and (row["contender"], row["count"]) in list_contenders(task)]
        print("", task_id, summarise(own), *(f"- {describe(found)}" for found in compare(own)), sep="\n")


if __name__ == "__main__":
    main()
