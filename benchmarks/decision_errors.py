"""Exploration and exploitation errors of baselines, the Bayes planner, scripted callers and learners on four rungs.

    python -m benchmarks.decision_errors                       # writes decision-errors.json and prints the table
    python -m benchmarks.decision_errors --rungs pair --rooms 3 --games 0 --out /tmp/errors.json

Finished lines in the file are kept, and the same command resumes. Every player plays one episode in each of the first
test rooms of a rung. Trained agents come with the package, or are trained in the rung's training rooms. Errors are sums
of an episode in primitives, means over rooms; those from actions are shares of
decisions. The last part draws graphs for one room, lets a player that guesses play each once, and reports
the mean of regret, errors, luck and path with standard errors: luck is zero in expectation.
"""

from __future__ import annotations

import dataclasses
import itertools
import sys
from collections.abc import Collection, Iterator, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

from hrl_escape.agents.agent import Agent
from hrl_escape.agents.making import make_agent
from hrl_escape.agents.spec import AgentSpec
from hrl_escape.agents.training.evaluation import compute_episode_seed, play_episode
from hrl_escape.agents.training.train import train
from hrl_escape.benchmark.agent_env import make_agent_env, make_player
from hrl_escape.benchmark.episodes import StateRecorder
from hrl_escape.benchmark.pretrained import list_pretrained, load_pretrained
from hrl_escape.benchmark.references.action_errors import estimate_errors
from hrl_escape.benchmark.references.decision_errors import EpisodeErrors, ErrorMeter
from hrl_escape.benchmark.replay import make_view_env
from hrl_escape.cli import run_script
from hrl_escape.env.instance import RoomInstance
from hrl_escape.files import read_json, write_json
from hrl_escape.planning.best_known import find_best_known
from hrl_escape.sets.benchmark import load_benchmark
from hrl_escape.sets.instance_set import InstanceSet

REFERENCES = ("bayes", "search-nearest", "search-random", "search-backtrack", "sweep", "sweep-random")
CALLERS = (("random", "names"), ("search-random", "names"), ("search-nearest", "places"), ("oracle", "model"))
LEARNERS = ("smdp-q-learning", "smdp-dqn", "smdp-ppo")
PACKAGED, GUESSED = "comes with the package", "chain-3"


@dataclasses.dataclass(frozen=True)
class Args:
    """Options of the benchmark."""

    rungs: tuple[str, ...] = ("pair", "chain-3", "chain", "lattice-5")
    """Rungs of ladder-1."""
    rooms: int = 10
    """Test rooms of each rung, from the first."""
    primitives: int = 10_000
    """Primitives of training; 0 leaves out the agents that are trained here."""
    games: int = 1000
    """Games with drawn graphs; 0 leaves them out."""
    out: Path = Path(__file__).parent / "decision-errors.json"
    """File for the results."""


def list_players(rung: str, test: InstanceSet, seeds: Sequence[int], primitives: int, done: Collection[tuple[str, str]]
                 ) -> Iterator[tuple[str, str, Agent, gymnasium.Env, StateRecorder]]:
    """Kind, name, player, environment and recorder of every player of a rung that is not done."""
    schedule = {str(seed): number for number, seed in enumerate(seeds)}
    specs = [("reference", name, AgentSpec(name)) for name in REFERENCES]
    specs += [("caller", f"{model}, {reveal}", AgentSpec("text-agent", settings={"model": model, "reveal": reveal}))
              for model, reveal in CALLERS]
    for kind, name, spec in specs:
        if (kind, name) in done:
            continue
        env, recorder = make_agent_env(spec, test, "features", schedule)
        yield kind, name, make_player(spec, env, recorder), env, recorder
    if ("reference", "random-options") not in done:
        spec = AgentSpec("random-options")
        env, recorder = make_agent_env(spec, test, "features", schedule)
        yield "reference", "random-options", make_agent(spec, env.observation_space, env.action_space, 0), env, recorder
    for name in list_pretrained().get(f"ladder-1/{rung}", ()):
        if (PACKAGED, name) in done:
            continue
        loaded = load_pretrained(f"ladder-1/{rung}", name)
        env, recorder = make_view_env(loaded.card.view, test, schedule)
        yield PACKAGED, name, loaded.agent, env, recorder
    kind = f"trained for {primitives:,} primitives"
    for name in LEARNERS if primitives else ():
        if (kind, name) in done:
            continue
        spec = AgentSpec.parse(name)
        train_env, _ = make_agent_env(spec, load_benchmark("ladder-1")[rung].train, "features")
        agent = make_agent(spec, train_env.observation_space, train_env.action_space, 0)
        with closing(train_env):
            train(agent, train_env, primitives=primitives, eval_episodes=0, progress=False)
        env, recorder = make_agent_env(spec, test, "features", schedule)
        yield kind, name, agent, env, recorder


def play(player: Agent, env: gymnasium.Env, recorder: StateRecorder, seed: int) -> tuple[Any, list[Any], bool]:
    """First state and decisions of an episode, and whether it ended with an escape."""
    decisions, escaped = [], False
    for _, info in play_episode(player, env, seed):
        decisions.append(env.get_wrapper_attr("last_steps"))
        escaped = bool(info["is_success"])
    return recorder.states[0], decisions, escaped


def measure_rung(rung: str, args: Args, done: Collection[tuple[str, str]]) -> Iterator[dict[str, Any]]:
    """One line for every player that is not done."""
    test = load_benchmark("ladder-1")[rung].test
    seeds = [compute_episode_seed(0, "evaluation", number) for number in range(args.rooms)]
    meters = [ErrorMeter(test[number], test.config) for number in range(args.rooms)]
    for kind, name, player, env, recorder in list_players(rung, test, seeds, args.primitives, done):
        lines = []
        for number, seed in enumerate(seeds):
            start, decisions, escaped = play(player, env, recorder, seed)
            errors = meters[number].measure(start, decisions)
            primitives = sum(map(len, decisions))
            fewest = find_best_known(test[number], start).primitives or 1
            lines.append((escaped, min(1.0, fewest / primitives) if escaped else 0.0, primitives, errors.exploration,
                          errors.exploitation, errors.luck, errors.path, errors.regret,
                          *estimate_errors(test[number], decisions)))
        env.close()
        keys = ("success", "efficiency", "primitives", "exploration", "exploitation", "luck", "path", "regret",
                "exploration_from_actions", "exploitation_from_actions")
        yield {"rung": rung, "kind": kind, "player": name, "rooms": args.rooms,
               **{key: round(float(value), 4) for key, value in zip(keys, np.mean(lines, axis=0), strict=True)}}


def draw_games(count: int) -> Iterator[EpisodeErrors]:
    """Errors of a player that guesses, in one room with drawn graphs."""
    rung = load_benchmark("ladder-1")[GUESSED]
    room, rng = rung.test[1], np.random.default_rng(0)
    orders = [*itertools.permutations(range(len(room.targets)))]
    made: dict[int, tuple[RoomInstance, ErrorMeter, Any, StateRecorder, Agent]] = {}
    for game in range(count):
        number = int(rng.integers(len(orders)))
        if number not in made:
            puzzle: Any = dataclasses.replace(  # type: ignore[type-var]  # a puzzle of buttons
                room.puzzle, edge_list=tuple(sorted(itertools.pairwise(orders[number]))), goal=orders[number][-1])
            drawn = dataclasses.replace(room, puzzle=puzzle)
            spec = AgentSpec("search-random")
            env, recorder = make_agent_env(spec, drawn, "features")
            made[number] = (drawn, ErrorMeter(drawn, rung.config), env, recorder, make_player(spec, env, recorder))
        _, meter, env, recorder, player = made[number]
        start, decisions, _ = play(player, env, recorder, game)
        yield meter.measure(start, decisions)


def run(args: Args) -> None:
    """Play, write the results and print the table."""
    settings = {"rooms": args.rooms, "primitives_of_training": args.primitives}
    known = read_json(args.out, "results") if args.out.exists() else {}
    lines = known["lines"] if known and {key: known[key] for key in settings} == settings else []
    order = [rung.name for rung in load_benchmark("ladder-1")]
    found: dict[str, Any] = {**settings, "lines": lines, **({"games": known["games"]} if "games" in known else {})}
    for rung in args.rungs:
        done = {(line["kind"], line["player"]) for line in lines if line["rung"] == rung}
        for line in measure_rung(rung, args, done):
            lines.append(line)
            lines.sort(key=lambda each: order.index(each["rung"]))
            write_json(args.out, found)
            print(*(f"{line[key]}" for key in line if key != "rooms"), sep="  ", file=sys.stderr, flush=True)
    if args.games:
        errors = [*draw_games(args.games)]
        parts = {key: np.array([getattr(each, key) for each in errors])
                 for key in ("regret", "exploration", "exploitation", "luck", "path")}
        found["games"] = {"count": args.games, "rung": GUESSED, "player": "search-random", **{
            key: {"mean": round(float(values.mean()), 4), "standard_error": round(float(
                values.std(ddof=1) / np.sqrt(len(values))), 4)} for key, values in parts.items()}}
        print(found["games"], file=sys.stderr)
    write_json(args.out, found)
    print("\n".join(make_table(lines)))


def make_table(lines: Sequence[dict[str, Any]]) -> list[str]:
    """Rows of a Markdown table, one for each rung and player."""
    rows = ["| rung | player | success | efficiency | exploration | exploitation | luck | path | "
            "exploration, actions | exploitation, actions |", "|---|---|---|---|---|---|---|---|---|---|"]
    for line in lines:
        name = f"{line['player']} ({line['kind']})" if line["kind"] != "reference" else line["player"]
        rows.append(f"| `{line['rung']}` | {name} | {line['success']:.1f} | {line['efficiency']:.2f} | "
                    f"{line['exploration']:.1f} | {line['exploitation']:.1f} | {line['luck']:.1f} | "
                    f"{line['path']:.1f} | {line['exploration_from_actions']:.2f} | "
                    f"{line['exploitation_from_actions']:.2f} |")
    return rows


if __name__ == "__main__":
    sys.exit(run_script(run))
