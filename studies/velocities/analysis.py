"""SAC over options beside SAC over velocities, both in seconds of motion: how it ends, and how soon it first escapes.

All act in the same continuous rooms. What counts is the mean time of the episodes that end in the last fifth of
training, where one that does not escape counts with the time limit.
"""

from __future__ import annotations

import copy
import dataclasses
import itertools
import math
from collections.abc import Mapping, Sequence
from typing import Any, TypeAlias

import gymnasium
import matplotlib
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator
from numpy.typing import NDArray
from rich.console import Console

from hrl_escape.agents.training.env_description import compute_digest
from hrl_escape.agents.training.evaluation import evaluate
from hrl_escape.agents.training.train import train
from hrl_escape.benchmark.episodes import StateRecorder
from hrl_escape.benchmark.references.registry import SEARCH_BASELINES, make_reference
from hrl_escape.env.config import RoomConfig
from hrl_escape.env.continuous import EscapeRoomContinuousEnv
from hrl_escape.env.kinematics import EpisodeEnd
from hrl_escape.env.pictures import palette
from hrl_escape.env.presets import get_preset
from hrl_escape.errors import ComparisonError, EscapeError
from hrl_escape.names import count_nouns, join_words
from hrl_escape.options.options_env import OptionsEnv
from hrl_escape.planning.motion.trajectory import make_trajectory, track
from hrl_escape.planning.planner import RoomPlanner
from studies.figures import FIGURE_STYLE, finish_axes
from studies.page import make_table
from studies.running import StudyArgs
from studies.statistics import Difference, compare_signs
from studies.store import Store
from studies.study import Page, Study

__all__ = ["LINES", "Args", "VelocityRun", "advise", "analyse", "make_room", "measure", "run_once", "tell_ends",
           "tell_first_escapes", "tell_headline", "tell_searchers"]

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


# --- words -----------------------------------------------------------------------------------


Pair: TypeAlias = tuple[Sequence[float], Sequence[float]]
"""Numbers of SAC over options and of SAC over velocities, run by run."""


def compare(pairs: Mapping[str, Pair]) -> dict[str, Difference]:
    """The first number of each pair less the second, those of all rooms as one family."""
    return compare_signs({name: np.subtract(*pair) for name, pair in pairs.items()})


def tell_headline(ends: Mapping[str, Pair]) -> str:
    """In which rooms which of the two escapes sooner at the end of training."""
    parts = [f"{who} escapes sooner with {join_words(rooms)}"
             for who, rooms in zip((OPTIONS, VELOCITIES), _list_sooner(ends), strict=True) if rooms]
    return (", ".join(parts) or "No room tells SAC over options and SAC over velocities apart") + "."


def advise(ends: Mapping[str, Pair]) -> str:
    """Advice to a user that follows from the rooms."""
    options, velocities = _list_sooner(ends)
    if options and velocities:
        return f"With {join_words(options)} give a robot options; with {join_words(velocities)} velocities end sooner."
    if options:
        return "Give a robot options: velocities do not make up for them."
    return "Velocities are enough in such rooms." if velocities else "In such rooms choose by what your robot takes."


def _list_sooner(ends: Mapping[str, Pair]) -> list[list[str]]:
    """Rooms in which SAC over options is shown to escape sooner at the end, and those in which velocities are."""
    found = compare(ends)
    return [[room for room, gap in found.items() if gap.sign == sign] for sign in (-1, 1)]


def tell_ends(ends: Mapping[str, Pair]) -> list[str]:
    """A sentence a room: who escapes sooner at the end of training, options or velocities.

    Args:
        ends: room -> seconds of an episode over options and over velocities, run by run.
    """
    sentences = []
    for room, gap in compare(ends).items():
        options, velocities = (float(np.mean(own)) for own in ends[room])
        told = (f"({options:.1f} s over options, {velocities:.1f} s over velocities; a difference of {gap.mean:+.1f} "
                f"s, {gap.low:+.1f} to {gap.high:+.1f})")
        sentences.append(f"**{room.capitalize()}.** At the end of training, " + {
            -1: f"SAC over options escapes sooner than SAC over velocities {told}.",
            0: f"no difference between SAC over options and over velocities is shown {told}.",
            1: f"SAC over velocities escapes sooner than SAC over options {told}."}[gap.sign])
    return sentences


def tell_first_escapes(firsts: Mapping[str, Pair], budget: float = math.inf) -> list[str]:
    """A sentence a room: which of the two finds its first way out sooner, by the geometric mean of the ratios.

    Args:
        firsts: room -> seconds to the first escape over options and over velocities, run by run; the whole budget
            where none came.
        budget: seconds of a run.
    """
    sentences = []
    for room, gap in compare({room: _take_logarithms(pair) for room, pair in firsts.items()}).items():
        ratio, low, high = (math.exp(value) for value in (-gap.mean, -gap.high, -gap.low))
        never = [[seconds >= budget for seconds in own] for own in firsts[room]]
        told = f"{_name_bound(*never)}{ratio:.1f} times the motion ({low:.1f} to {high:.1f})"
        if any(map(any, never)):
            told += (f"; runs that never escape, {sum(never[0])} of {len(never[0])} over options and {sum(never[1])} "
                     "over velocities, count with the whole budget")
            if both := sum(map(all, zip(*never, strict=True))):
                told += f", so that {count_nouns(both, 'pair')} of {len(never[0])} count{'s' * (both == 1)} as equal"
        sentences.append(f"**{room.capitalize()}, first escape.** " + {
            -1: f"Over velocities it costs {told}.",
            0: f"That options find it sooner is not shown: velocities take {told}.",
            1: f"Velocities find it sooner: they take {told}."}[gap.sign])
    return sentences


def _name_bound(options: Sequence[bool], velocities: Sequence[bool]) -> str:
    """Words before a ratio of velocities to options that is only a bound, by which runs never escape, pair by pair.

    A pair in which neither does bounds nothing.
    """
    alone = {by_options for by_options, by_velocities in zip(options, velocities, strict=True)
             if by_options != by_velocities}
    return "" if len(alone) != 1 else "less than " if True in alone else "more than "


def _take_logarithms(pair: Pair) -> Pair:
    return np.log(pair[0]).tolist(), np.log(pair[1]).tolist()


def tell_searchers(ends: Mapping[str, Pair], searchers: Mapping[str, float]
                   ) -> list[str]:
    """A sentence a room: each learner against the best searcher over options, which learns nothing."""
    gaps = compare({f"{room}/{who}": (own, [searchers[room]] * len(own)) for room, pair in ends.items()
                    for who, own in zip((OPTIONS, VELOCITIES), pair, strict=True)})
    sentences = []
    for room in ends:
        told = [f"{who} {('needs less', 'is not told apart from it', 'needs more')[gap.sign + 1]} "
                f"({np.mean(own):.1f} s)"
                for who, own in zip((OPTIONS, VELOCITIES), ends[room], strict=True)
                for gap in [gaps[f"{room}/{who}"]]]
        sentences.append(f"**{room.capitalize()}, searching.** The best searcher over options, which learns nothing, "
                         f"needs {searchers[room]:.1f} s; at the end of training {told[0]}, and {told[1]}.")
    return sentences


def describe(runs: Sequence[VelocityRun], budget: float) -> list[str]:
    """Cells of the table: time at the end and first escape, means over runs with their range."""
    ends = [run.end for run in runs]
    cells = [f"{np.mean(ends):.1f}" + (f" ({min(ends):.1f} to {max(ends):.1f})" if len(runs) > 1 else "")]
    if len(runs) == 1:
        return [*cells, ""]
    firsts = sorted(run.first_escape or math.inf for run in runs)
    middle = float(np.median(firsts))
    missed = sum(map(math.isinf, firsts))
    return [*cells, (f"{middle:,.0f}" if middle < budget else "none") + (f"; {missed} never" if missed else "")]


def analyse(study: Study, lines: Sequence[VelocityRun]) -> Page:
    """Sentences, table and figure.

    Raises:
        ComparisonError: a room has no pair of learners, or a reference is missing.
    """
    data, budget = study.data, study.data["steps"] * study.data["time_step"]
    by_place = {(room, agent): sorted((line for line in lines if (line.room, line.agent) == (room, agent)
                                       and line.steps in (0, data["steps"])
                                       and line.key == make_key(data, agent, room)),
                                      key=lambda line: line.run)
                for room in data["rooms"] for agent in (OPTIONS, VELOCITIES, *CHANCE, ORDER, PLAN, *data["searchers"])}
    if missing := [f"{agent} in {room}" for (room, agent), own in by_place.items() if not own]:
        raise ComparisonError(f"there is no run of {missing[0]}")
    ends, firsts = {}, {}
    for room in data["rooms"]:
        own = [{line.run: line for line in by_place[room, agent]} for agent in (OPTIONS, VELOCITIES)]
        seeds = sorted(own[0].keys() & own[1].keys())
        ends[room] = tuple([runs[seed].end for seed in seeds] for runs in own)
        firsts[room] = tuple([runs[seed].first_escape or budget for seed in seeds] for runs in own)
    searchers = {room: min(by_place[room, name][0].end for name in data["searchers"] if name in SEARCH_BASELINES)
                 for room in data["rooms"]}
    rows = [[f"`{agent}`" if agent in data["searchers"] else agent,
             *itertools.chain.from_iterable(describe(by_place[room, agent], budget) for room in data["rooms"])]
            for agent in (OPTIONS, VELOCITIES, *CHANCE, *data["searchers"], ORDER, PLAN)]
    head = ["", *itertools.chain.from_iterable((f"{room}: end, s", "first escape, s") for room in data["rooms"])]
    told = [tell_ends(ends), tell_first_escapes(firsts, budget), tell_searchers(ends, searchers)]
    sentences = [sentence for room in zip(*told, strict=True) for sentence in room]
    return Page({"headline": tell_headline(ends), "advice": advise(ends), "sentences": sentences,
                 "table": make_table(head, rows), "budget": budget,
                 "runs": min(len(pair[0]) for pair in ends.values())},
                {"velocities": draw(data, by_place, searchers)}, sentences)


def draw(data: Mapping[str, Any], by_place: Mapping[tuple[str, str], Sequence[VelocityRun]],
         searchers: Mapping[str, float]) -> Figure:
    """Seconds of an episode over the course of training, a panel a room; a thin line a run, a thick one their mean."""
    budget = data["steps"] * data["time_step"]
    with matplotlib.rc_context(FIGURE_STYLE):
        figure = Figure(figsize=(8.4, 3.4), facecolor=palette.BACKGROUND, layout="constrained")
        panels: Any = figure.subplots(1, len(data["rooms"]), sharey=True, squeeze=False)
        at: NDArray[np.float64] = (np.arange(PARTS) + 0.5) * budget / PARTS
        for axes, room in zip(panels[0], data["rooms"], strict=True):
            axes.set(title=room, xlabel="seconds of motion trained for", yscale="log")
            for agent, colour in zip((OPTIONS, VELOCITIES), palette.LINES, strict=False):
                curves = np.array([[math.nan if time is None else time for time in run.times]
                                   for run in by_place[room, agent]])
                axes.plot(at, curves.T, color=colour, alpha=0.25, linewidth=0.8)
                axes.plot(at, np.ma.masked_invalid(curves).mean(axis=0), "o-", color=colour, markersize=3, label=agent)
            for time, style, label in ((searchers[room], "--", "best searcher over options"),
                                       (by_place[room, PLAN][0].end, ":", "the planner's trajectory")):
                axes.axhline(time, linestyle=style, color=palette.MUTED, linewidth=1.2, label=label)
            finish_axes(axes)
            axes.yaxis.set_major_locator(FixedLocator([5, 10, 20, 50, 100, 200]))
            axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
            axes.yaxis.set_minor_locator(NullLocator())
        panels[0][0].set_ylabel("seconds of an episode")
        panels[0][-1].legend(loc="lower left", frameon=False, fontsize=8)
    return figure
