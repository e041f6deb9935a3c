"""SAC over options and SAC over velocities, both in seconds of motion: how it ends, and how soon it first escapes.

All act in the same continuous rooms. What counts is the mean time of the episodes that end in the last fifth of
training, where one that does not escape counts with the time limit.
"""

from __future__ import annotations

import copy
import dataclasses
import itertools
import math
from collections.abc import Mapping, Sequence
from types import SimpleNamespace
from typing import Any

import gymnasium
import numpy as np
from rich.console import Console

from hrl_escape.agents.spec import AgentSpec
from hrl_escape.agents.training.env_description import compute_digest
from hrl_escape.agents.training.evaluation import evaluate
from hrl_escape.agents.training.train import train
from hrl_escape.benchmark.episodes import StateRecorder
from hrl_escape.benchmark.references.registry import SEARCH_BASELINES, make_reference
from hrl_escape.env.config import RoomConfig
from hrl_escape.env.continuous import EscapeRoomContinuousEnv
from hrl_escape.env.kinematics import EpisodeEnd
from hrl_escape.env.presets import get_preset
from hrl_escape.errors import ComparisonError, EscapeError
from hrl_escape.options.options_env import OptionsEnv
from hrl_escape.planning.motion.trajectory import make_trajectory, track
from hrl_escape.planning.planner import RoomPlanner
from studies.running import StudyArgs
from studies.statistics import compare_signs
from studies.store import Store
from studies.study import Findings, Study
from studies.tables import make_table

__all__ = ["LINES", "Args", "VelocityRun", "analyse", "make_room", "measure", "run_once"]

OPTIONS, VELOCITIES = "SAC over options", "SAC over velocities"
CHANCE = ("random options", "random velocities")
ORDER, PLAN = "the best order of options", "the planner's trajectory"
PARTS = 10
"""Parts of a run whose episodes are averaged."""
LAST = 2
"""Parts at the end that count."""
SAC: dict[str, Any] = {"batch_size": 64, "policy_kwargs": {"net_arch": [64, 64]}}
"""Settings of Stable-Baselines3's SAC that are not its defaults: networks and batches as large as `torchrl-sac` has."""


@dataclasses.dataclass(frozen=True)
class Args(StudyArgs):
    """Options of the study."""

    runs: int | None = None
    """Training seeds; those of `study.toml` by default."""


@dataclasses.dataclass(frozen=True)
class VelocityRun:
    """One run in one room.

    Attributes:
        agent: words on who acts, or the name of a searcher.
        room: name of the room.
        run: training seed.
        steps: of training; 0 of who does not train.
        first_escape: seconds of motion until the first escape; None if none came.
        times: mean seconds of the episodes that end in each part of the run, None where none does; of who does not
            learn one number.
        key: hash of what else decides the run's numbers.
    """

    agent: str
    room: str
    run: int
    steps: int
    first_escape: float | None
    times: tuple[float | None, ...]
    key: str

    @property
    def place(self) -> tuple[str, str, int, int, str]:
        """Subject of the line."""
        return self.agent, self.room, self.run, self.steps, self.key

    @property
    def end(self) -> float:
        """Mean seconds of an episode at the end, over the parts in which episodes end."""
        return float(np.mean([time for time in self.times[-LAST:] if time is not None]))


LINES = (VelocityRun,)


# --- runs ------------------------------------------------------------------------------------


class EpisodeEnds(gymnasium.Wrapper):
    """Record of the episodes of a room that ended.

    Attributes:
        steps: steps since the first episode began.
        ends: of each episode: `steps` at its end, its own steps, whether it escaped.
    """

    def __init__(self, env: gymnasium.Env) -> None:
        super().__init__(env)
        self.steps, self.ends, self._begin = 0, list[tuple[int, int, bool]](), 0

    def reset(self, **settings: Any) -> tuple[Any, dict[str, Any]]:
        """Begin an episode."""
        self._begin = self.steps
        return self.env.reset(**settings)

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Step, and record the end of an episode."""
        found = self.env.step(action)
        self.steps += 1
        if found[2] or found[3]:
            self.ends.append((self.steps, self.steps - self._begin, bool(found[4]["is_success"])))
        return found


def make_key(data: Mapping[str, Any], agent: str, room: str) -> str:
    """Hash of the room and of the settings of who acts in it."""
    settings = {OPTIONS: data["settings"], VELOCITIES: SAC} | {name: data["episodes"] for name in data["searchers"]}
    return compute_digest([data["rooms"][room], data["time_step"], data["time_limit"], settings.get(agent)])


def make_room(data: Mapping[str, Any], room: str) -> EscapeRoomContinuousEnv:
    """The continuous room of this name in `study.toml`."""
    chosen = data["rooms"][room]
    config = get_preset(chosen["preset"]).to_dict()
    config["room"] |= {"width": chosen["side"], "depth": chosen["side"]}
    return EscapeRoomContinuousEnv(RoomConfig.from_dict(config), time_step=data["time_step"], observation="features",
                                   time_limit=data["time_limit"])


def run_once(data: Mapping[str, Any], agent: str, room: str, seed: int) -> VelocityRun:
    """Train, or let act at random, for the study's steps."""
    log, steps = EpisodeEnds(make_room(data, room)), data["steps"]
    if agent in (OPTIONS, CHANCE[0]):
        name, settings = ("torchrl-sac", data["settings"]) if agent == OPTIONS else ("random-options", {})
        train(name, OptionsEnv(log), primitives=steps, seed=seed, settings=settings, eval_episodes=0, progress=False)
    elif agent == VELOCITIES:
        make_sac(log, seed).learn(steps)
    else:
        _act_at_random(log, steps, seed)
    return summarise(agent, room, seed, log.ends, steps, data)


def make_sac(env: gymnasium.Env, seed: int) -> Any:
    """Stable-Baselines3's SAC, with `SAC` in place of some of its default settings.

    Raises:
        EscapeError: the extra `bench` is missing.
    """
    try:
        import stable_baselines3
    except ImportError:
        raise EscapeError("this study trains Stable-Baselines3's SAC: pip install 'hrl-escape[bench]'") from None
    settings = copy.deepcopy(SAC)  # SAC adds to the dict of its policy's settings
    return stable_baselines3.SAC("MlpPolicy", env, seed=seed, device="cpu", **settings)


def _act_at_random(env: gymnasium.Env, steps: int, seed: int) -> None:
    env.action_space.seed(seed)
    is_over = True
    for _ in range(steps):
        if is_over:
            env.reset()
        _, _, terminated, truncated, _ = env.step(env.action_space.sample())
        is_over = terminated or truncated


def summarise(agent: str, room: str, seed: int, ends: Sequence[tuple[int, int, bool]], steps: int,
              data: Mapping[str, Any]) -> VelocityRun:
    """Times of the episodes of a run, part by part; one that fails counts with the time limit."""
    parts: list[list[float]] = [[] for _ in range(PARTS)]
    for at, length, escaped in ends:
        parts[min(PARTS - 1, (at - 1) * PARTS // steps)].append(
            length * data["time_step"] if escaped else data["time_limit"])
    first = next((at * data["time_step"] for at, _, escaped in ends if escaped), None)
    return VelocityRun(agent, room, seed, steps, first,
                       tuple(round(float(np.mean(own)), 3) if own else None for own in parts),
                       make_key(data, agent, room))


def play_reference(data: Mapping[str, Any], name: str, room: str) -> VelocityRun:
    """Play a searcher's episodes, the planner's trajectory, or all orders of options, of which the best counts."""
    recorder = StateRecorder(make_room(data, room))
    if name == PLAN:
        recorder.reset(seed=0)
        start: Any = recorder.unwrapped
        found = track(make_trajectory(RoomPlanner(start.instance).solve(start.get_state())), recorder)
        times = [found.seconds if found.end is EpisodeEnd.ESCAPED else data["time_limit"]]
    elif name == ORDER:
        env = OptionsEnv(recorder)
        *presses, leave = range(len(env.options))
        times = [min(_play_order(env, (*order, leave)) * data["time_step"]
                     for count in range(len(presses) + 1) for order in itertools.permutations(presses, count))]
    else:
        env = OptionsEnv(recorder)
        played = evaluate(make_reference(name, env, recorder), env, data["episodes"])
        times = [length * data["time_step"] if escaped else data["time_limit"]
                 for length, escaped in zip(played.lengths, played.successes, strict=True)]
    return VelocityRun(name, room, 0, 0, None, (round(float(np.mean(times)), 3),), make_key(data, name, room))


def _play_order(env: OptionsEnv, order: Sequence[int]) -> float:
    """Steps until these options have led out; infinite if they do not."""
    env.reset(seed=0)
    steps = 0
    for option in order:
        _, _, terminated, truncated, info = env.step(option)
        steps += int(info["duration"])
        if terminated or truncated:
            return steps if info["is_success"] else math.inf
    return math.inf


def measure(study: Study, args: Args, store: Store) -> None:
    """Run what is missing, references first, then seed by seed."""
    data, known, console = study.data, {line.place for line in store.load()}, Console()
    for room, name in itertools.product(data["rooms"], (PLAN, ORDER, *data["searchers"])):
        if (name, room, 0, 0, make_key(data, name, room)) not in known:
            store.add([play_reference(data, name, room)])
    for seed, room, agent in ((seed, room, agent) for seed in range(args.runs or data["runs"])
                              for room in data["rooms"] for agent in (OPTIONS, VELOCITIES, *CHANCE)):
        if (agent, room, seed, data["steps"], make_key(data, agent, room)) not in known:
            line = run_once(data, agent, room, seed)
            store.add([line])
            console.print(f"{agent}, {room}, seed {seed}: {line.end:.1f} s at the end", highlight=False)


# --- findings --------------------------------------------------------------------------------


def analyse(study: Study, lines: Sequence[VelocityRun]) -> Findings:
    """Seconds of an episode at the end of training and of motion until the first escape, in each room.

    Raises:
        ComparisonError: a room has no pair of learners, or a reference is missing.
    """
    data, budget = study.data, study.data["steps"] * study.data["time_step"]
    agents = (OPTIONS, VELOCITIES, *CHANCE, *data["searchers"], ORDER, PLAN)
    of = {(room, agent): sorted((line for line in lines if (line.room, line.agent) == (room, agent)
                                 and line.steps in (0, data["steps"]) and line.key == make_key(data, agent, room)),
                                key=lambda line: line.run) for room in data["rooms"] for agent in agents}
    if missing := [f"{agent} in {room}" for (room, agent), own in of.items() if not own]:
        raise ComparisonError(f"there is no run of {missing[0]}")
    pairs = {room: [{line.run: line for line in of[room, agent]} for agent in (OPTIONS, VELOCITIES)]
             for room in data["rooms"]}
    ends = compare_signs({room: [options[seed].end - velocities[seed].end
                                 for seed in sorted(options.keys() & velocities.keys())]
                          for room, (options, velocities) in pairs.items()})
    searched = {room: min(of[room, name][0].end for name in data["searchers"] if name in SEARCH_BASELINES)
                for room in data["rooms"]}
    never = {(room, agent): sum(line.first_escape is None for line in of[room, agent])
             for room in data["rooms"] for agent in (OPTIONS, VELOCITIES)}
    head = ["", *itertools.chain.from_iterable((f"{room}: end, s", "first escape, s") for room in data["rooms"])]
    return Findings(
        SimpleNamespace(ends=ends, searched=searched, never=never,
                        means={cell: float(np.mean([line.end for line in own])) for cell, own in of.items()},
                        runs=min(len(options.keys() & velocities.keys()) for options, velocities in pairs.values())),
        {"velocities": make_table(head, [
            [AgentSpec.parse(agent).title if agent in data["searchers"] else agent,
             *itertools.chain.from_iterable(describe(of[room, agent], budget) for room in data["rooms"])]
            for agent in agents])})


def describe(runs: Sequence[VelocityRun], budget: float) -> list[str]:
    """Cells of the table: time at the end, mean over runs with their range, and the median of the first escapes."""
    ends = [run.end for run in runs]
    cells = [f"{np.mean(ends):.1f}" + (f" ({min(ends):.1f} to {max(ends):.1f})" if len(runs) > 1 else "")]
    if len(runs) == 1:
        return [*cells, ""]
    firsts = sorted(run.first_escape or math.inf for run in runs)
    middle = float(np.median(firsts))
    missed = sum(map(math.isinf, firsts))
    return [*cells, (f"{middle:,.0f}" if middle < budget else "none") + (f"; {missed} never" if missed else "")]
