"""How much is learned from a primitive, and in a second, as environments grow from 1 to 4,096?

    python -m benchmarks.environments_scaled choose    # which rule of settings, on CartPole: two minutes of a core
    python -m benchmarks.environments_scaled           # the rule against the defaults, in a room: 15 minutes
    python -m benchmarks.environments_scaled --quick   # seconds: shows that everything runs

A rule gives `ppo` settings for each number of environments. The one with the highest mean return over the run, evenly
over 64, 512 and 4,096 environments, is chosen on CartPole, and no run in the room is looked at for it. All are
evaluated after the same numbers of primitives, of all environments together, in the same greedy episodes; seconds are
of processor time, without evaluations. Finished runs are kept, a line each, in the file `--out`. The command continues
a stopped run, seed by seed, and every line of the table has as many runs.
"""

from __future__ import annotations

import argparse
import json
import math
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import gymnasium
import matplotlib
import numpy as np
import torch
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter, NullFormatter

import hrl_escape  # noqa: F401  # registers the rooms
from benchmarks.learning_curves import Contender, Marks, compare, describe, train_in_many, train_in_one
from hrl_escape.agents import evaluate, make_agent
from hrl_escape.env.pictures import palette
from hrl_escape.figures import STYLE, save_figure

COUNTS = (1, 8, 64, 512, 4096)
CHOOSING, REPORTED = "CartPole-v1", "hrl_escape/PaperOneButton-v1"
BUDGETS = {CHOOSING: 65_536, REPORTED: 65_536}
CHOICE_COUNTS, CHOICE_SEEDS = (64, 512, 4096), (100, 101)
ARGUMENTS: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    CHOOSING: ({}, {}), REPORTED: ({"observation": "features"}, {"output": "torch"})}
"""Arguments of an environment, and further ones of many."""
EVALUATIONS, EPISODES = 16, {CHOOSING: 5, REPORTED: 3}


def cut(count: int, steps: int, batch: int = 64) -> dict[str, Any]:
    """Rollouts of at least 2,048 decisions and a number of each environment, in minibatches of a size.

    The step size grows with the root of the minibatch.
    """
    rollout = max(2048, steps * count)
    return {"rollout_per_env": max(1, rollout // count), "rollout": rollout, "batch_size": batch,
            "learning_rate": 1e-3 * math.sqrt(batch / 64)}


RULES: dict[str, Callable[[int], dict[str, Any]]] = {
    "defaults": lambda count: {},
    "one step": lambda count: {} if count < 64 else cut(count, 1),
    "eight steps": lambda count: {} if count < 64 else cut(count, 8, 256),
}
"""Name -> settings for a number of environments; below 64 all are the defaults."""


class Timer:
    """Score of a learner, with the processor seconds of training before it."""

    def __init__(self, task: str) -> None:
        self._env, self._episodes = gymnasium.make(task, **ARGUMENTS[task][0]), EPISODES[task]
        self._trained, self._since = 0.0, time.process_time()
        self.seconds: list[float] = []

    def __call__(self, learner: Any) -> float:
        """Mean return of greedy episodes."""
        self._trained += time.process_time() - self._since
        self.seconds.append(round(self._trained, 2))
        score = evaluate(learner, self._env, self._episodes, seed=0).mean_return
        self._since = time.process_time()
        return score


def execute(task: str, contender: str, count: int, seed: int, primitives: int) -> dict[str, Any]:
    """Returns, and processor seconds, at the marks of a run."""
    single, further = ARGUMENTS[task]
    timer = Timer(task)
    marks = Marks([primitives * (number + 1) // EVALUATIONS for number in range(EVALUATIONS)], timer)
    env: Any = (gymnasium.make(task, **single) if count == 1 else
                gymnasium.make_vec(task, num_envs=count, **single, **further))
    space = env.observation_space if count == 1 else env.single_observation_space
    actions = env.action_space if count == 1 else env.single_action_space
    agent: Any = make_agent("ppo", space, actions, seed, **RULES[contender](count))
    (train_in_one if count == 1 else train_in_many)(agent, env, seed, marks)
    return {"scores": marks.scores, "seconds": timer.seconds}


def list_runs(what: str, chosen: str, seeds: Sequence[int]) -> list[tuple[str, str, int, int]]:
    """(task, rule, environments, seed) of every run, seed by seed."""
    if what == "choose":
        return [(CHOOSING, rule, count, seed) for seed in CHOICE_SEEDS for rule in RULES for count in CHOICE_COUNTS]
    return [(REPORTED, rule, count, seed) for seed in seeds for count in COUNTS[::-1]
            for rule in dict.fromkeys(("defaults", chosen)) if rule == "defaults" or count >= 64]


def choose_rule(rows: Sequence[dict[str, Any]]) -> str:
    """The rule of the highest mean return over the run, evenly over numbers of environments; the first of equals."""
    def rate(rule: str) -> float:
        return float(np.mean([np.mean([take_scores(row) for row in rows
                                       if (row["contender"], row["count"]) == (rule, count)])
                              for count in CHOICE_COUNTS]))

    return max(RULES, key=rate)


def take_scores(row: dict[str, Any]) -> list[float]:
    """Returns of a run's evaluations."""
    return [score for _, score in row["scores"]]


def list_pairs(chosen: str) -> list[tuple[Contender, Contender]]:
    """Contenders that are compared: the rule with the defaults, and both with one environment."""
    many = [count for count in COUNTS if count >= 64]
    rules = list(dict.fromkeys(("defaults", chosen)))
    return [*((Contender(rule, count), Contender("defaults", 1)) for rule in rules for count in COUNTS[1:]
              if rule == "defaults" or count in many),
            *((Contender(chosen, count), Contender("defaults", count)) for count in many if chosen != "defaults")]


def summarise(rows: Sequence[dict[str, Any]]) -> str:
    """A table with a line for each rule and number of environments of one task."""
    lines = ["| settings | environments | runs | after 1/4 | 1/2 | all | over the run | seconds |",
             "|---|---|---|---|---|---|---|---|"]
    for (rule, count), own in group(rows).items():
        scores = np.array([take_scores(row) for row in own]).mean(axis=0)
        marks = " | ".join(f"{scores[len(scores) * part // 4 - 1]:.0f}" for part in (1, 2, 4))
        seconds = np.mean([row["seconds"][-1] for row in own])
        lines.append(f"| {rule} | {count:,} | {len(own)} | {marks} | {scores.mean():.0f} | {seconds:.1f} |")
    return "\n".join(lines)


def group(rows: Sequence[dict[str, Any]]) -> dict[tuple[str, int], list[dict[str, Any]]]:
    """Runs by rule and number of environments, few environments first."""
    found: dict[tuple[str, int], list[dict[str, Any]]] = {}
    for row in sorted(rows, key=lambda row: (row["count"], list(RULES).index(row["contender"]))):
        found.setdefault((row["contender"], row["count"]), []).append(row)
    return found


def draw(rows: Sequence[dict[str, Any]]) -> Figure:
    """Mean return against primitives and against seconds: a line for each number, dashed at the defaults."""
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(8.4, 3.4), facecolor=palette.BACKGROUND, layout="constrained")
        left, right = figure.subplots(1, 2, sharey=True)
        for (rule, count), own in group(rows).items():
            scores, seconds = (np.array(values).mean(axis=0) for values in
                               ([take_scores(row) for row in own], [row["seconds"] for row in own]))
            style: dict[str, Any] = {"color": palette.LINES[COUNTS.index(count)],
                                     "linestyle": "--" if rule == "defaults" and count >= 64 else "-",
                                     "label": f"{count:,}" if rule != "defaults" or count < 64 else None}
            left.plot([mark for mark, _ in own[0]["scores"]], scores, **style)
            right.plot(seconds, scores, **style)
        left.set(xlabel="primitives, of all environments", ylabel="greedy return")
        right.set(xlabel="seconds of processor time", xscale="log")
        right.xaxis.set_minor_formatter(NullFormatter())
        right.legend(title="environments", frameon=False, fontsize=8)
        for axes in (left, right):
            axes.xaxis.set_major_formatter(EngFormatter(sep=""))
            axes.spines[["top", "right"]].set_visible(False)
    return figure


def main() -> None:
    """Run what is missing, then print the table, and draw."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", nargs="?", choices=["choose", "report"], default="report")
    parser.add_argument("--seeds", nargs="+", type=int, default=list(range(10)))
    parser.add_argument("--out", type=Path, default=Path("environments_scaled.jsonl"), help="where runs are kept")
    parser.add_argument("--draw", type=Path, help="figure: svg, png or pdf")
    parser.add_argument("--quick", action="store_true", help="a sixteenth of each budget, one seed")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    rows = [json.loads(line) for line in arguments.out.read_text().splitlines()] if arguments.out.exists() else []
    part = 16 if arguments.quick else 1
    choice = [row for row in rows if (row["task"], row["primitives"]) == (CHOOSING, BUDGETS[CHOOSING] // part)]
    is_chosen = len(choice) == len(RULES) * len(CHOICE_COUNTS) * len(CHOICE_SEEDS)
    chosen = choose_rule(choice) if is_chosen else "eight steps"
    if not (is_chosen or arguments.quick or arguments.what == "choose"):
        parser.error(f"{arguments.out} holds no choice of a rule yet: run `choose` first")
    for task, rule, count, seed in list_runs(arguments.what, chosen, arguments.seeds[: 1 if part > 1 else None]):
        run = {"task": task, "contender": rule, "count": count, "seed": seed, "primitives": BUDGETS[task] // part}
        if any(row.items() >= run.items() for row in rows):
            continue
        rows.append(run | execute(**run))
        with arguments.out.open("a") as file:
            file.write(json.dumps(rows[-1]) + "\n")
        print(f"{rule}, {count:,}, seed {seed}: {np.mean(take_scores(rows[-1])):.0f} over the run", flush=True)
    task = CHOOSING if arguments.what == "choose" else REPORTED
    own = [row for row in rows if (row["task"], row["primitives"]) == (task, BUDGETS[task] // part)]
    print("", summarise(own), sep="\n")
    if task == CHOOSING:
        print(f"chosen: {choose_rule(own)}")
    else:
        print("", *(f"- {describe(found)}" for found in compare(own, list_pairs(chosen))), sep="\n")
    if arguments.draw:
        save_figure(arguments.draw, draw(own))


if __name__ == "__main__":
    main()
