"""Learning from data sets: the horizon (decisions or primitives), stitching (cut trajectories), and unseen rooms."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, Literal

import gymnasium
import matplotlib
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from rich.console import Console
from scipy import stats  # pyright: ignore[reportMissingTypeStubs]

from hrl_escape.agents.agent import Agent
from hrl_escape.agents.spec import REFERENCES, AgentSpec
from hrl_escape.agents.training.evaluation import Evaluation, evaluate
from hrl_escape.agents.training.train import train
from hrl_escape.benchmark.episodes import StateRecorder
from hrl_escape.benchmark.references.registry import SEARCH_BASELINES, make_reference
from hrl_escape.benchmark.statistics import compute_mean_efficiency
from hrl_escape.commands.room_choice import split_assignment
from hrl_escape.data.catalogue import find_recording
from hrl_escape.data.materialise import load_data
from hrl_escape.data.recording import load_recording
from hrl_escape.env.pictures import palette
from hrl_escape.errors import ComparisonError, ConfigError
from hrl_escape.names import join_words
from hrl_escape.options.options_env import OptionsEnv
from studies.figures import FIGURE_STYLE, finish_axes
from studies.page import make_table
from studies.running import StudyArgs
from studies.statistics import compute_sign_flip_p
from studies.store import Store
from studies.study import Page, Study
from studies.unseen import count_fewest, get_unseen, play_unseen

__all__ = ["LINES", "Args", "OfflineResult", "analyse", "measure", "name_unseen", "reads_decisions", "run_once",
           "run_unseen", "tell_difference", "tell_stitching", "tell_unseen"]

SURE = 0.025
"""Two-sided level of a question, 5 % in all, for each side."""
WEAK = 0.1
"""Efficiency below which a learner has nothing to lose."""
BEHAVIOUR, UNSEEN = "behaviour", "unseen"
WHOLE = "play"
"""Kind whose trajectories begin where episodes do, so that they have an efficiency of their own."""
OPTIONS_ALONE = AgentSpec.parse("random-options")
"""Says what all choose among in unseen rooms."""


@dataclasses.dataclass(frozen=True)
class Args(StudyArgs):
    """Options of the study."""

    runs: int | None = None
    """Rooms; those of `study.toml` by default."""


@dataclasses.dataclass(frozen=True)
class OfflineResult:
    """Efficiency of one learner of one data set in one room, or in rooms that the data does not hold.

    Attributes:
        agent: with its settings; `behaviour` is the data itself, others without a data set are references.
        kind: of the data set; empty for a reference; after `UNSEEN` where it learned of all rooms and is tested in
            others, as in `unseen play`.
        run: number of the room, in unseen rooms the training seed.
        efficiency: mean over episodes of escaped x best known primitives / primitives.
    """

    agent: str
    kind: str
    run: int
    efficiency: float

    @property
    def place(self) -> tuple[str, str, int]:
        """Subject of the line."""
        return self.agent, self.kind, self.run


LINES = (OfflineResult,)


# --- runs ------------------------------------------------------------------------------------


def score(evaluation: Evaluation, fewest: float) -> float:
    """Mean efficiency of some episodes."""
    return compute_mean_efficiency(evaluation.escaped, evaluation.lengths, fewest, is_expected=False)


def read_learner(text: str) -> tuple[str, dict[str, Any]]:
    """Name and settings of a learner, from `name setting=value ...`."""
    name, *settings = text.split()
    return name, dict(split_assignment(each, "learner", "best=0.1") for each in settings)


def name_unseen(kind: str) -> str:
    """`kind` of a result in unseen rooms; that of a searcher, without a data set, is `UNSEEN` alone."""
    return f"{UNSEEN} {kind}".strip()


def run_unseen(agent: str, kind: str, rung: str, seed: int, tested: int) -> OfflineResult:
    """Train on all rooms that a data set holds, or play a searcher; an episode in each of other rooms."""
    def make_player(env: gymnasium.Env, recorder: StateRecorder) -> Agent:
        if agent in REFERENCES:
            return make_reference(agent, env, recorder)
        name, settings = read_learner(agent)
        player = train(name, env, data=load_data(f"{rung}-{kind}-v1", observation="objects"), seed=seed,
                       settings={"values": "network", "network": "objects"} | settings, eval_episodes=0,
                       progress=False).agent
        assert player is not None  # a run without a folder gives its agent back
        return player

    efficiency, _ = play_unseen(OPTIONS_ALONE, get_unseen("ladder-1", rung, tested), make_player)
    return OfflineResult(agent, name_unseen(kind), seed, efficiency)


def reads_decisions(agent: str) -> bool:
    """Return whether a learner reads the decisions of a data set, beside their primitives or alone."""
    return agent.startswith(("smdp-", "hiql"))


def run_once(agent: str, kind: str, rung: str, run: int, episodes: int) -> OfflineResult:
    """Train one learner on what a data set holds of one room, and test it there; for `BEHAVIOUR` rate the data."""
    whole = load_recording(find_recording(f"{rung}-{kind}-v1"))
    recording, fewest = whole.select(run), count_fewest(whole.rooms[run])
    if agent == BEHAVIOUR:
        data = load_data(recording, observation="features").read_decisions(1.0)
        ended = np.bincount(data.trajectory, data.terminated) > 0
        lengths = np.bincount(data.trajectory, data.duration)
        return OfflineResult(agent, kind, run, compute_mean_efficiency(ended, lengths, fewest, is_expected=False))
    name, given = read_learner(agent)
    options = name.startswith("smdp-")
    env = whole.rooms[run : run + 1].make_env({"include_primitives": False} if options else False,
                                              observation="features")
    try:
        result = train(name, env, data=load_data(recording, observation="features"), seed=run, eval_episodes=episodes,
                       settings={"values": "table", "passes": 400} | given, eval_every=2**40, progress=False,
                       observed=False)
    finally:
        env.close()
    return OfflineResult(agent, kind, run, score(result.evaluations[-1], fewest))


def run_searcher(searcher: str, rung: str, run: int, episodes: int) -> OfflineResult:
    """Play a searcher in the room of a run."""
    recording = load_recording(find_recording(f"{rung}-play-v1"))
    recorder = StateRecorder(recording.rooms[run : run + 1].make_env(observation="features"))
    env = OptionsEnv(recorder, include_primitives=False)
    try:
        found = evaluate(make_reference(searcher, env, recorder), env, episodes)
    finally:
        env.close()
    return OfflineResult(searcher, "", run, score(found, count_fewest(recording.rooms[run])))


def measure(study: Study, args: Args, store: Store) -> None:
    """Run what is missing: room by room, then seed by seed in unseen rooms.

    Raises:
        ConfigError: the rooms would reach those that settings were chosen in; nothing is run.
    """
    data, console = study.data, Console(stderr=True, highlight=False)
    runs, tuned = args.runs or data["runs"], data["tuned_rooms"][0]
    if runs > tuned:
        raise ConfigError("runs", runs, f"at most {tuned}, since settings were chosen in the rooms from {tuned} on")
    known = {line.place for line in store.load()}
    for run in range(runs):
        cells = [(BEHAVIOUR, WHOLE), *((agent, kind) for kind in data["kinds"] for agent in data["learners"])]
        missing = [(agent, kind) for agent, kind in cells if (agent, kind, run) not in known]
        store.add([run_once(agent, kind, data["rung"], run, data["episodes"]) for agent, kind in missing])
        store.add([run_searcher(searcher, data["rung"], run, data["episodes"]) for searcher in data["searchers"]
                   if (searcher, "", run) not in known])
        if missing:
            console.print(f"room {run}: {len(missing)} runs", markup=False)
    unseen = data["unseen"]
    for agent, kind, seed in [(searcher, "", 0) for searcher in data["searchers"]] + [
            (agent, kind, seed) for seed in range(args.runs or unseen["runs"]) for kind in unseen["kinds"]
            for agent in unseen["learners"]]:
        if (agent, name_unseen(kind), seed) not in known:
            line = run_unseen(agent, kind, data["rung"], seed, unseen["tested"])
            store.add([line])
            console.print(f"{agent}, {line.kind}, seed {seed}: {line.efficiency:.3f}", markup=False)


# --- words -----------------------------------------------------------------------------------


def judge(first: NDArray[np.float64], second: NDArray[np.float64], choices: int = 1) -> Literal["up", "down", "level"]:
    """Judge whether the first of paired efficiencies are shown to be higher (`up`), the second (`down`), or neither.

    Args:
        first: one a room.
        second: of the same rooms.
        choices: number of such questions asked at once, which the level is divided by.
    """
    differences = np.subtract(first, second)
    if compute_sign_flip_p(differences, "above") <= SURE / choices:
        return "up"
    return "down" if compute_sign_flip_p(differences, "below") <= SURE / choices else "level"


def quote(first: NDArray[np.float64], second: NDArray[np.float64]) -> str:
    """Numbers of a comparison, in brackets."""
    return f"({np.mean(first):.2f} against {np.mean(second):.2f}, {len(first)} rooms)"


def tell_difference(first: NDArray[np.float64], second: NDArray[np.float64], better: str, worse: str, alike: str,
                    choices: int = 1) -> str:
    """One of three sentences on paired efficiencies: the first are higher, the second are, or neither is shown.

    Args:
        first: one a room.
        second: of the same rooms.
        better: sentence where the first are higher.
        worse: sentence where the second are.
        alike: sentence where the signs could be chance.
        choices: see `judge`.
    """
    chosen = {"up": better, "down": worse, "level": alike}[judge(first, second, choices)]
    return f"{chosen} {quote(first, second)}."


def tell_stitching(pairs: Mapping[str, tuple[NDArray[np.float64], NDArray[np.float64]]]) -> list[str]:
    """Sentences on what cut trajectories cost, learners of one verdict together; one family of tests (Bonferroni).

    A learner below `WEAK` with whole trajectories has nothing to lose, and is told apart.

    Args:
        pairs: what a learner is -> efficiency from whole trajectories and from cut ones, one a room each.
    """
    openings = {"up": "Cut trajectories cost some", "down": "Cut trajectories help some",
                "level": "Cut trajectories cost nothing that shows",
                "weak": "Too little is learned from whole trajectories to lose anything"}
    found: dict[str, list[str]] = {verdict: [] for verdict in openings}
    for name, (whole, cut) in pairs.items():
        verdict = judge(whole, cut, len(pairs))
        found["weak" if verdict == "level" and whole.mean() < WEAK else verdict].append(f"{name} {quote(whole, cut)}")
    return [f"**Stitching.** {openings[verdict]}: {join_words(names)}." for verdict, names in found.items() if names]


def tell_unseen(scores: Mapping[tuple[str, str], NDArray[np.float64]], words: Mapping[str, str], searcher: float
                ) -> list[str]:
    """Sentences on rooms that no data holds: the best network by the interval of its mean, then each data set's best.

    Args:
        scores: of each learner and kind of data, one a training seed.
        words: what each learner stands for.
        searcher: efficiency of the searcher in the same rooms.
    """
    means = {cell: float(found.mean()) for cell, found in scores.items()}
    best = max(means, key=lambda cell: means[cell])
    mean, count = means[best], len(scores[best])
    level = 1 - SURE / len(scores)  # the best of so many is looked at
    error = stats.t.ppf(level, count - 1) * scores[best].std(ddof=1) / count**0.5 if count > 1 else np.inf
    if mean - error > searcher:
        verdict = "does better than the best searcher"
    elif mean + error < searcher:
        verdict = "does worse than the best searcher, which needs no data"
    else:
        verdict = "cannot be told apart from the best searcher, which needs no data"
    kinds = dict.fromkeys(kind for _, kind in scores)
    leaders = {kind: max((cell for cell in scores if cell[1] == kind), key=lambda cell: means[cell]) for kind in kinds}
    if len(leaders) > 1 and len({agent for agent, _ in leaders.values()}) == 1:
        ordered = sorted(leaders, key=lambda kind: -means[leaders[kind]])
        listed = f"{words[best[0]]}, " + join_words(f"{means[leaders[kind]]:.2f} from `{kind}`" for kind in ordered)
        which = f"In unseen rooms one learner is the best of every kind of data: {listed}."
    else:
        listed = join_words([f"{words[agent]} from `{kind}` ({means[agent, kind]:.2f})"
                             for kind, (agent, _) in leaders.items()])
        which = f"In unseen rooms the best of each kind of data: {listed}."
    return [f"**Unseen rooms.** The best network, {words[best[0]]} from `{best[1]}`, {verdict} ({mean:.2f}, "
            f"{mean - error:.2f} to {mean + error:.2f}, against {searcher:.2f}).",
            f"**Which data.** {which}"]


def analyse(study: Study, lines: Sequence[OfflineResult]) -> Page:
    """Sentences, tables and figure.

    Raises:
        ComparisonError: there are no runs.
    """
    if not lines:
        raise ComparisonError("there are no runs to tell of")
    data = study.data
    words: Mapping[str, str] = {BEHAVIOUR: "the data itself"} | data["learners"]
    by = {line.place: line.efficiency for line in lines}
    rooms = sorted({line.run for line in lines if not line.kind.startswith(UNSEEN)})

    def read(agent: str, kind: str) -> NDArray[np.float64]:
        return np.array([by[agent, kind, room] for room in rooms])

    horizon = [tell_difference(read(mine, "play"), read(other, "play"),
                               f"**Horizon.** From the same data, {words[mine]} does better than {words[other]}",
                               f"**Horizon.** From the same data, {words[other]} does better than {words[mine]}",
                               f"**Horizon.** From the same data, {words[mine]} and {words[other]} cannot be told "
                               "apart")
               for mine, other in data["pairs"].items()]
    stitching = tell_stitching({words[agent]: (read(agent, "play"), read(agent, "stitch"))
                                for agent in data["learners"] if reads_decisions(agent)})
    outside = data["unseen"]["learners"]
    scores = {(agent, kind): np.array([line.efficiency for line in lines
                                       if (line.agent, line.kind) == (agent, name_unseen(kind))])
              for agent in outside for kind in data["unseen"]["kinds"]}
    searchers = {name: read(name, "") for name in data["searchers"]}
    elsewhere = {name: by[name, UNSEEN, 0] for name in data["searchers"]}
    bars = [name for name in searchers if name in SEARCH_BASELINES]
    searcher = searchers[max(bars, key=lambda name: np.mean(searchers[name]))]
    unseen = tell_unseen(scores, outside, max(elsewhere[name] for name in bars))
    best = max(data["learners"], key=lambda agent: np.mean(read(agent, "play")))
    headline = tell_difference(
        read(best, "play"), searcher,
        f"A thousand primitives of random play teach {words[best]} more about a room than the best searcher finds out "
        "in an episode",
        f"The best searcher that learns nothing does better than {words[best]} with a thousand primitives of random "
        "play",
        f"{words[best].capitalize()} with a thousand primitives of random play cannot be told apart from the best "
        "searcher that learns nothing", choices=len(data["learners"]))
    rows = [[f"{word} (`{agent}`)", *(f"{np.mean(read(agent, kind)):.2f}" if is_rated(agent, kind) else ""
                                      for kind in data["kinds"])] for agent, word in words.items()]
    rows += [[describe_searcher(name), *[f"{np.mean(found):.2f}"] * len(data["kinds"])]
             for name, found in searchers.items()]
    others = [[f"{word} (`{agent}`)", *(describe_runs(scores[agent, kind]) for kind in data["unseen"]["kinds"])]
              for agent, word in outside.items()]
    others += [[describe_searcher(name), *[f"{value:.2f}"] * len(data["unseen"]["kinds"])]
               for name, value in elsewhere.items()]
    sentences = [*horizon, *stitching, *unseen]
    return Page({"headline": headline, "sentences": sentences, "rooms": len(rooms), "rung": data["rung"],
                 "tested": data["unseen"]["tested"], "table": make_table(["learner", *data["kinds"]], rows),
                 "tuned": data["tuned_rooms"], "seeds": min(map(len, scores.values())),
                 "unseen": make_table(["network", *data["unseen"]["kinds"]], others)},
                {"offline": draw(data["kinds"], words, read, searcher)}, [headline, *sentences])


def describe_searcher(name: str) -> str:
    """Words of a reference in the tables."""
    is_bar = name in SEARCH_BASELINES
    return f"{'searcher that learns nothing' if is_bar else 'told how rooms are drawn'} (`{name}`)"


def describe_runs(found: NDArray[np.float64]) -> str:
    """Mean of runs and their range."""
    return f"{found.mean():.2f} ({found.min():.2f} to {found.max():.2f})"


def is_rated(agent: str, kind: str) -> bool:
    """True where efficiency is that of whole episodes; pieces of `stitch` begin anywhere."""
    return agent != BEHAVIOUR or kind == WHOLE


def draw(kinds: Sequence[str], words: Mapping[str, str], read: Any, searcher: NDArray[np.float64]) -> Figure:
    """Efficiency of each learner of each data set, rooms as dots, and the best searcher as a line."""
    with matplotlib.rc_context(FIGURE_STYLE):
        figure = Figure(figsize=(7.6, 4.0), facecolor=palette.BACKGROUND, layout="constrained")
        axes = figure.add_subplot()
        places = np.arange(len(words))[::-1].astype(float)
        spread = np.random.default_rng(0)
        for number, kind in enumerate(kinds):
            colour, shift = palette.LINES[number], 0.18 * (1 - 2 * number)
            for place, agent in zip(places, words, strict=True):
                if not is_rated(agent, kind):
                    continue
                values = read(agent, kind)
                rows = place + shift + spread.uniform(-0.09, 0.09, len(values))
                axes.scatter(values, rows, s=9, alpha=0.35, color=colour, linewidths=0)
                axes.plot([np.mean(values)], [place + shift], "D", color=colour, markersize=6,
                          label=kind if place == places[-1] else None)
        axes.axvline(float(np.mean(searcher)), color="#555555", linewidth=1, linestyle="--", label="best searcher")
        finish_axes(axes)
        axes.set_yticks(places, list(words.values()))
        axes.set(xlabel="efficiency (the planner: 1)", xlim=(-0.03, 1.05))
        axes.legend(frameon=False, loc="upper center", bbox_to_anchor=(0.5, 1.12), ncols=3)
    return figure
