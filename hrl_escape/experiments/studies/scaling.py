"""How learning scales with buttons: one trial is an agent in a room of some graph, size and violation rule.

A trial notes when the agent first escaped, when its frozen policy first came near the best, and how much of
the dependency graph it had recovered by when; then it stops early. Trials are kept one file each, so a study that is
killed goes on. The page is written in `scaling_page.py`.
"""

from __future__ import annotations

import csv
import io
import os
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, fields
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import gymnasium

from hrl_escape.agents.agent import make_transition, read_action_mask
from hrl_escape.agents.evaluation import compute_episode_seed, evaluate
from hrl_escape.agents.random import RandomAgent
from hrl_escape.agents.registry import make_agent
from hrl_escape.env.config import RobotConfig, RoomConfig, ShapeConfig
from hrl_escape.env.generation import generate
from hrl_escape.env.puzzles.base import Panels
from hrl_escape.env.puzzles.buttons import ButtonsConfig
from hrl_escape.env.puzzles.graphs import GraphConfig
from hrl_escape.errors import FileReadError
from hrl_escape.experiments.grid import AgentSpec
from hrl_escape.experiments.launcher import THREAD_SETTINGS
from hrl_escape.files import read_json, read_text, write_json, write_text

__all__ = [
    "AGENTS", "BAR", "GRAPHS", "NEAR_BEST", "RULES", "SIZES", "Trial", "TrialResult",
    "find_edges_that_matter", "load_results", "make_room", "run_trial", "run_trials", "save_results",
]  # fmt: skip

GRAPHS = ("chain", "tree", "layered", "random")
SIZES = (2, 4, 6, 10, 15, 20)
RULES = ("ignore", "reset")
AGENTS = (
    "smdp-factored-r-max",
    "smdp-monte-carlo-model",
    "smdp-r-max",
    "smdp-q-learning",
    "smdp-intra-option-q",
    "smdp-dqn",
    "smdp-sarsa",
    "smdp-ddpg",
    "smdp-ppo",
    "smdp-random",
)
BAR = (("layered", 20, "ignore"), ("layered", 10, "reset"))
"""Where factored R-MAX has ten runs: the literature's bar of 10 to 20 buttons modelled within 20,000 steps."""
BAR_AGENT, BAR_RUNS = "smdp-factored-r-max", 10
MAX_PARENTS = 2
NEAR_BEST = 0.95
EVALUATION_STEP, GRAPH_STEP = 500, 100
"""Primitives between evaluations, which happen between episodes, and between looks at the graph."""


@dataclass(frozen=True)
class Trial:
    """What is tried.

    Attributes:
        graph: family of the dependency graph.
        buttons: how many.
        rule: what a press with unmet parents does.
        agent: name.
        run: seeds room, agent and episodes.
    """

    graph: str
    buttons: int
    rule: str
    agent: str
    run: int

    @property
    def name(self) -> str:
        """Name of its file."""
        return f"{self.graph}-{self.buttons}-{self.rule}--{self.agent}--{self.run}"


@dataclass(frozen=True)
class TrialResult:
    """What came of a trial.

    Attributes:
        graph: see `Trial`; so the next four.
        room: content hash of the instance.
        best: best return known for these options.
        worst: return without escape.
        primitives: trained for.
        decisions: trained for.
        seconds: of wall time, evaluations included.
        first_escape: primitives at the end of the first training episode that escaped; None if none did.
        near_best: primitives at the first of two evaluations in a row that scored `NEAR_BEST`; None if none did.
        edges: how many edges matter.
        structure: (primitives, precision, recall) whenever a look found a change; empty for agents without a graph.
    """

    graph: str
    buttons: int
    rule: str
    agent: str
    run: int
    room: str
    best: float
    worst: float
    primitives: int
    decisions: int
    seconds: float
    first_escape: int | None
    near_best: int | None
    edges: int
    structure: tuple[tuple[int, float, float], ...]

    @property
    def trial(self) -> Trial:
        """What was tried."""
        return Trial(self.graph, self.buttons, self.rule, self.agent, self.run)


def make_room(graph: str, buttons: int, rule: str) -> RoomConfig:
    """The ladder's room: small buttons anywhere on the walls; 30 m wide from 11 buttons on."""
    size = 20.0 if buttons <= 10 else 30.0
    puzzle = ButtonsConfig(
        count=buttons, graph=GraphConfig(kind=graph, max_parents=MAX_PARENTS), on_violation=rule,
        buttons=Panels(width=1.5),
    )  # fmt: skip
    return RoomConfig(
        name=f"{graph}-{buttons}-{rule}", room=ShapeConfig(width=size, depth=size),
        robot=RobotConfig(body_radius=0.5), puzzle=puzzle,
    )  # fmt: skip


def find_edges_that_matter(edges: Iterable[tuple[int, int]], goal: int) -> frozenset[tuple[int, int]]:
    """Edges that some order of presses towards the goal can tell from none.

    Those among the goal's ancestors that no longer way implies: where a leads to b and b to c, an edge from a to
    c changes nothing, and nobody can find it.

    Args:
        edges: (parent, child) pairs; a believed graph may have cycles.
        goal: the goal button.
    """
    every = set(edges)
    ancestors, before = {goal}, 0
    while len(ancestors) > before:
        before = len(ancestors)
        ancestors |= {parent for parent, child in every if child in ancestors}
    kept = {(parent, child) for parent, child in every if child in ancestors}

    def is_implied(edge: tuple[int, int]) -> bool:
        reached, frontier = {edge[0]}, [edge[0]]
        while frontier:
            node = frontier.pop()
            for following in (other for other in kept if other[0] == node and other != edge):
                if following[1] not in reached:
                    reached.add(following[1])
                    frontier.append(following[1])
        return edge[1] in reached

    return frozenset(edge for edge in kept if not is_implied(edge))


def compare_graphs(found: frozenset[tuple[int, int]], true: frozenset[tuple[int, int]]) -> tuple[float, float]:
    """Precision (1 where nothing was found but nothing is there, else 0) and recall of edges."""
    hits = len(found & true)
    return hits / len(found) if found else float(not true), hits / len(true) if true else 1.0


def run_trial(trial: Trial, primitives: int) -> TrialResult:
    """Train one agent; over once it is near the best and has the whole graph, or at the budget.

    The random agent, which gets no better, is done when it has escaped once.

    Args:
        trial: which.
        primitives: the budget.
    """
    import hrl_escape  # noqa: F401  # registers the environment
    from hrl_escape.options.best_known import best_known_return  # these bring the planners in
    from hrl_escape.options.options_env import OptionsEnv

    started = time.perf_counter()
    instance = generate(make_room(trial.graph, trial.buttons, trial.rule), trial.run)
    flat = gymnasium.make("hrl_escape/EscapeRoom-v0", instance=instance, observation="features",
                          disable_env_checker=True)
    env = OptionsEnv(flat, include_primitives=False, trace=AgentSpec(trial.agent).needs_trace)
    try:
        worst = instance.horizon * instance.reward.step
        best = best_known_return(instance, options="press")
        agent = make_agent(trial.agent, env.observation_space, env.action_space, trial.run)
        puzzle: Any = instance.puzzle
        true = find_edges_that_matter(puzzle.edges, puzzle.goal)
        first_bit = int(env.observation_space.shape[0]) - trial.buttons  # pyright: ignore[reportOptionalSubscript]
        watch = _Watch(agent, true, puzzle.goal, first_bit, lambda value: (value - worst) / (best - worst))
        used = decisions = episode = 0
        while used < primitives and not watch.is_complete:
            observation, info = env.reset(seed=compute_episode_seed(trial.run, "training", episode))
            mask = read_action_mask(info, len(env.action_names))
            is_over = False
            while not is_over and used < primitives:
                action = agent.act(observation, mask)
                transition = make_transition(observation, action, mask, env.step(action), agent.gamma)
                agent.observe(transition)
                used, decisions = used + transition.duration, decisions + 1
                observation, mask = transition.next_observation, transition.next_action_mask
                is_over = transition.terminated or transition.truncated
                watch.look_at_graph(used)
                if transition.terminated:
                    watch.first_escape = watch.first_escape or used
            episode += 1
            watch.look_at_policy(env, used)
    finally:
        env.close()
    return TrialResult(
        **asdict(trial), room=instance.id, best=best, worst=worst, primitives=used, decisions=decisions,
        seconds=round(time.perf_counter() - started, 1), first_escape=watch.first_escape, near_best=watch.near_best,
        edges=len(true), structure=tuple(watch.structure),
    )  # fmt: skip


class _Watch:
    """What is noted of an agent while it learns."""

    def __init__(
        self, agent: Any, true: frozenset[tuple[int, int]], goal: int, first_bit: int, score: Callable[[float], float]
    ) -> None:
        self._agent, self._true, self._goal, self._first_bit, self._score = agent, true, goal, first_bit, score
        self._has_graph = hasattr(agent, "get_graph")
        self._learns = not isinstance(agent, RandomAgent)
        self.structure: list[tuple[int, float, float]] = []
        self.first_escape: int | None = None
        self.near_best: int | None = None
        self._candidate: int | None = None
        self._next = self._next_graph = 0

    @property
    def is_complete(self) -> bool:
        """Nothing is left to be noted."""
        if not self._learns:
            return self.first_escape is not None
        has_all = not self._has_graph or (bool(self.structure) and self.structure[-1][1:] == (1.0, 1.0))
        return self.near_best is not None and has_all

    def look_at_graph(self, primitives: int) -> None:
        """Compare the graph that is believed now, if there is one and it is time."""
        if not self._has_graph or primitives < self._next_graph:
            return
        self._next_graph = primitives + GRAPH_STEP
        first = self._first_bit
        edges = {(p - first, c - first) for p, c in self._agent.get_graph() if p >= first and c >= first}
        precision, recall = compare_graphs(find_edges_that_matter(edges, self._goal), self._true)
        now = round(precision, 4), round(recall, 4)
        if not self.structure or self.structure[-1][1:] != now:
            self.structure.append((primitives, *now))

    def look_at_policy(self, env: gymnasium.Env, primitives: int) -> None:
        """Evaluate, every so often, once it has escaped and until it is near the best."""
        if not self._learns or self.first_escape is None or self.near_best is not None or primitives < self._next:
            return
        self._next = primitives + EVALUATION_STEP
        if self._score(evaluate(self._agent, env, episodes=1).mean_return) < NEAR_BEST:
            self._candidate = None
        elif self._candidate is None:
            self._candidate = primitives
        else:
            self.near_best = self._candidate


def run_trials(
    out: Path, runs: int, primitives: int, workers: int, minutes: float, report: Callable[[TrialResult, int, int], None]
) -> list[TrialResult]:
    """Run what has no result yet: run by run, from small rooms to large, agent by agent.

    An agent that did not escape with fewer buttons is not tried with more (same graph, rule and run).

    Args:
        out: folder of results, one file a trial.
        runs: of each agent in each kind of room; the cells of `BAR` have `BAR_RUNS` if `runs` is positive.
        primitives: budget of a trial.
        workers: processes.
        minutes: begin no trial after so long.
        report: hears each result, how many trials of its round are done, and of how many.

    Returns:
        All results there are, also of earlier calls.
    """
    results: dict[Trial, TrialResult] = {}
    deadline = time.monotonic() + 60 * minutes
    for name in THREAD_SETTINGS:
        os.environ.setdefault(name, "1")
    with ProcessPoolExecutor(workers, mp_context=get_context("forkserver")) as pool:
        for trials in _list_rounds(runs, results):
            waiting = []
            for trial in trials:
                found = _read_result(out / f"{trial.name}.json", primitives)
                if found is not None:
                    results[trial] = found
                else:
                    waiting.append(trial)
            running = [pool.submit(_work, out, trial, primitives, deadline) for trial in waiting]
            for number, future in enumerate(running, 1):
                result = future.result()
                if result is not None:
                    results[result.trial] = result
                    report(result, number, len(running))
    return list(results.values())


def _list_rounds(runs: int, results: dict[Trial, TrialResult]) -> Iterator[list[Trial]]:
    """Trials that may run at the same time; a round depends on the results of those before."""
    if runs:
        yield [Trial(*cell, BAR_AGENT, run) for run in range(BAR_RUNS) for cell in BAR]
    for run in range(runs):
        for place, buttons in enumerate(SIZES):
            for agent in AGENTS:
                trials = []
                for graph in GRAPHS:
                    for rule in RULES:
                        smaller = results.get(Trial(graph, SIZES[place - 1], rule, agent, run)) if place else None
                        if place == 0 or (smaller is not None and smaller.first_escape is not None):
                            trials.append(Trial(graph, buttons, rule, agent, run))
                yield trials


def _work(out: Path, trial: Trial, primitives: int, deadline: float) -> TrialResult | None:
    if time.monotonic() > deadline:
        return None
    result = run_trial(trial, primitives)
    write_json(out / f"{trial.name}.json", {"budget": primitives, "result": asdict(result)}, indent=None)
    return result


def _read_result(path: Path, primitives: int) -> TrialResult | None:
    if not path.exists():
        return None
    content = read_json(path, "result of a trial")
    try:
        if content["budget"] != primitives:
            return None
        found = content["result"]
        return TrialResult(**{**found, "structure": tuple((int(n), p, r) for n, p, r in found["structure"])})
    except (KeyError, TypeError, ValueError) as error:
        raise FileReadError(f"{path}: this result of a trial is damaged ({error!r}). Delete it") from error


def save_results(path: Path, results: Sequence[TrialResult]) -> None:
    """Write results as CSV, a line each; `structure` is `primitives:precision:recall;...`.

    Raises:
        FileWriteError: the file cannot be written.
    """
    table = io.StringIO()
    writer = csv.writer(table, lineterminator="\n")
    names = [field.name for field in fields(TrialResult)]
    writer.writerow(names)
    for result in sorted(results, key=lambda r: (r.graph, r.buttons, r.rule, r.agent, r.run)):
        values = asdict(result)
        values["structure"] = ";".join(f"{n}:{p:g}:{r:g}" for n, p, r in result.structure)
        writer.writerow(["" if values[name] is None else values[name] for name in names])
    write_text(path, table.getvalue())


def load_results(path: Path) -> list[TrialResult]:
    """Read what `save_results` wrote.

    Raises:
        FileReadError: the file is missing or damaged.
    """
    found = []
    for number, row in enumerate(csv.DictReader(io.StringIO(read_text(path, "file of raw results"))), 2):
        try:
            steps = [step.split(":") for step in row["structure"].split(";") if step]
            if row["agent"] not in AGENTS:
                raise ValueError(f"no agent of this study is called {row['agent']!r}")
            found.append(TrialResult(
                row["graph"], int(row["buttons"]), row["rule"], row["agent"], int(row["run"]), row["room"],
                float(row["best"]), float(row["worst"]), int(row["primitives"]), int(row["decisions"]),
                float(row["seconds"]), int(row["first_escape"]) if row["first_escape"] else None,
                int(row["near_best"]) if row["near_best"] else None,
                edges=int(row["edges"]), structure=tuple((int(n), float(p), float(r)) for n, p, r in steps),
            ))  # fmt: skip
        except (KeyError, ValueError, TypeError, AttributeError) as error:
            raise FileReadError(f"{path}, line {number}: this is no result of a trial ({error!r})") from error
    return found
