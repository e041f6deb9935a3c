"""Evaluation of language models, people and scripts that call a room's tools.

    client = ChatClient("my-model", "http://localhost:8000/v1")
    print(evaluate_model(client, rung="chain-3", reveal="places", rooms=10).describe())

Every game is one episode in one room, with the score of all other agents and the errors of its decisions. With a
folder, each finished game is recorded, and the same call resumes.
"""

from __future__ import annotations

import contextlib
import dataclasses
import threading
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np

from hrl_escape.agents.text_agent import Level
from hrl_escape.benchmark.references.action_errors import estimate_errors
from hrl_escape.benchmark.references.decision_errors import ErrorMeter
from hrl_escape.env.config import RoomConfig
from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.env.puzzles.buttons import ButtonsPuzzle
from hrl_escape.errors import (
    ConfigError,
    EndpointError,
    FileReadError,
    RunMismatchError,
    UnknownNameError,
    UnsupportedError,
)
from hrl_escape.files import make_folder, read_json, write_json
from hrl_escape.names import count_nouns, join_words
from hrl_escape.options.options_env import OptionsEnv
from hrl_escape.sets.grammar import find_set
from hrl_escape.sets.instance_set import InstanceSet
from hrl_escape.settings import read_record
from hrl_escape.text.chat import Budget, ChatModel, GameStopped, Usage
from hrl_escape.text.managers import Model
from hrl_escape.text.recordings import record_game, replay_session, save_games, verify_games
from hrl_escape.text.text_env import Score, TextEnv

_SCHEMA = 1


@dataclasses.dataclass(frozen=True)
class GameResult:
    """A finished game.

    Attributes:
        room: number of the room in its set.
        score: score of the game.
        ended: end of the game: `over`, or why it stopped before.
        exploration: exploration errors, primitives, or None in rooms without exact beliefs.
        exploitation: exploitation errors, primitives, or None.
        luck: outcomes of presses minus their expectations, primitives, or None.
        exploration_from_actions: share of decisions, see `action_errors.py`; None without buttons.
        exploitation_from_actions: share of decisions, or None.
        usage: tokens and requests.
    """

    room: int
    score: Score
    ended: str
    exploration: float | None
    exploitation: float | None
    luck: float | None
    exploration_from_actions: float | None
    exploitation_from_actions: float | None
    usage: Usage

    def to_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        return dataclasses.asdict(self)

    @classmethod
    def from_dict(cls, value: Mapping[str, Any]) -> GameResult:
        """Read the values of `to_dict`; raises `ConfigError` for a value that is not valid."""
        return read_record(cls, value, "game")


@dataclasses.dataclass(frozen=True)
class ModelResult:
    """Games of a caller.

    Attributes:
        name: name of the caller.
        rooms: name of the set of rooms.
        reveal: level of revealed text.
        games: finished games, in the order of the rooms.
        unfinished: number of the room -> why its game is not finished.
        usage: tokens and requests of all games, including unfinished ones.
        cost: dollars, at the prices of the budget.
    """

    name: str
    rooms: str
    reveal: Level
    games: tuple[GameResult, ...]
    unfinished: Mapping[int, str]
    usage: Usage
    cost: float

    def to_row(self) -> dict[str, Any]:
        """Return means over finished games; None where no game has the number."""
        scores = [game.score for game in self.games]
        columns: dict[str, Sequence[float | None]] = {
            "success": [float(score.escaped) for score in scores],
            "efficiency": [score.efficiency for score in scores],
            "primitives": [score.primitives for score in scores],
            "calls": [score.decisions for score in scores],
            "wrong_calls": [score.invalid_calls for score in scores],
            **{name: [getattr(game, name) for game in self.games] for name in (
                "exploration", "exploitation", "luck", "exploration_from_actions", "exploitation_from_actions")}}
        means = {name: _compute_mean(values) for name, values in columns.items()}
        return {"caller": self.name, "rooms": self.rooms, "reveal": self.reveal, "games": len(self.games), **means,
                "prompt_tokens": self.usage.prompt_tokens, "completion_tokens": self.usage.completion_tokens,
                "cost": round(self.cost, 6)}

    def describe(self) -> str:
        """Return the row as two lines of a Markdown table, after its header."""
        row = self.to_row()
        shown = [value if isinstance(value, str) else "" if value is None else f"{value:,}" if isinstance(value, int)
                 else f"{value:.2f}" for value in row.values()]
        lines = [[name.replace("_", " ") for name in row], ["---"] * len(row), shown]
        return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _compute_mean(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return round(float(np.mean(known)), 4) if known else None


def evaluate_model(client: Any, rung: str = "pair", reveal: Level = "places", rooms: int = 10, *, seed: int = 0,
                   include_primitives: bool = False, games_at_once: int = 4, most_calls: int = 200,
                   budget: Budget | None = None, out: str | Path | None = None,
                   on_game: Callable[[GameResult], object] = lambda _: None) -> ModelResult:
    """Let a caller play the first test rooms of a rung, one game each.

    Args:
        client: `ChatClient`, or any function from transcript and tools to a call, see `hrl_escape.text.Model`.
        rung: rung of `ladder-1` such as `chain-3`, or a set of rooms such as `ladder-1/chain/test#5..9`.
        reveal: level of revealed text: `names`, `places` or `model`.
        rooms: number of rooms, for a rung.
        seed: episode seed of every game.
        include_primitives: whether `move` is offered.
        games_at_once: games that wait for replies at the same time. Only a `ChatClient` plays several.
        most_calls: most calls in a game.
        budget: limits of all games together.
        out: folder for results and recordings. Finished games in it are not played again.
        on_game: called after each finished game.

    Raises:
        EndpointError: no game could be finished, because the endpoint gave no reply.
        RunMismatchError: the folder holds games of another caller, other rooms or settings.
        FileReadError: the folder is damaged.
    """
    chosen = find_set(rung if "/" in rung else f"ladder-1/{rung}/test#0..{rooms}")
    for name, value in (("games_at_once", games_at_once), ("most_calls", most_calls)):
        if value < 1:
            raise ConfigError(name, value, "a whole number of at least 1")
    is_chat, budget = hasattr(client, "complete"), budget or Budget()
    name = str(getattr(client, "name", None) or getattr(client, "__qualname__", type(client).__qualname__))
    folder = None if out is None else Path(out)
    settings = {"schema": _SCHEMA, "caller": name, "endpoint": getattr(client, "endpoint", None), "rooms": chosen.name,
                "numbers": [room.id for room in chosen], "reveal": reveal, "seed": seed,
                "options": getattr(client, "options", {}), "include_primitives": include_primitives,
                "most_calls": most_calls}
    done = {} if folder is None else _resume(folder, settings, budget)
    simulation, results, problems = threading.Lock(), dict(done), dict[int, str]()
    failures: list[EndpointError] = []

    def play(number: int) -> None:
        if reason := budget.find_reason():
            problems[number] = reason
            return
        model: Any = ChatModel(client, budget) if is_chat else client
        try:
            result = _play_game(model, chosen, number, reveal, seed, include_primitives, most_calls, simulation, folder,
                                budget)
        except GameStopped as stopped:
            problems[number] = str(stopped)
        except EndpointError as error:
            problems[number] = str(error)
            failures.append(error)
        else:
            results[number] = result
            with simulation:
                on_game(result)
        with simulation:
            _write_usage(folder, budget)

    missing = [number for number in range(len(chosen)) if number not in done]
    if not is_chat:
        for number in missing:
            play(number)
    else:
        with ThreadPoolExecutor(games_at_once) as pool:
            try:
                list(pool.map(play, missing))
            except BaseException:
                budget.stop("the games were interrupted")
                pool.shutdown(wait=False, cancel_futures=True)
                raise
    if failures and not results:
        raise failures[0]
    return ModelResult(name, chosen.name, reveal, tuple(results[number] for number in sorted(results)),
                       dict(sorted(problems.items())), budget.spent, budget.spent.compute_cost(budget.prices))


def evaluate_recordings(name: str, paths: Iterable[str | Path]) -> ModelResult:
    """Return the row of recorded games of one caller: a person, a client of `hrl-escape mcp`, or a model elsewhere.

    Args:
        name: name of the caller.
        paths: files of recorded games. Each game is replayed.

    Raises:
        FileReadError: a file is missing or damaged.
        VerificationError: a game does not replay to the same bytes.
        ConfigError: there are no files, or games of several levels of `reveal`.
    """
    games = [game for path in paths for game in verify_games(path)]
    if len({game.reveal for game in games}) != 1:
        raise ConfigError("games", join_words(sorted({game.reveal for game in games})) or "none",
                          "games of one level of reveal, at least one")
    results = []
    for number, game in enumerate(games):
        with closing(replay_session(game).env) as env:
            results.append(GameResult(number, game.score, "over" if env.is_over else "stopped", **measure_game(env),
                                      usage=Usage()))
    rooms = join_words(sorted({game.room.name for game in games}))
    return ModelResult(name, rooms, games[0].reveal, tuple(results), {}, Usage(), 0.0)


def _play_game(model: Model, rooms: InstanceSet, number: int, reveal: Level, seed: int, include_primitives: bool,
               most_calls: int, simulation: threading.Lock, folder: Path | None, budget: Budget) -> GameResult:
    """Play one game; the rooms of all threads are stepped one at a time."""
    with simulation:
        env = TextEnv(OptionsEnv(EscapeRoomEnv(instance=rooms[number]), include_primitives=include_primitives), reveal)
        env.reset(seed=seed)
    if hasattr(model, "rng"):
        vars(model)["rng"] = np.random.default_rng(seed)
    ended = f"{count_nouns(most_calls, 'call')} made"
    with closing(env):
        for _ in range(most_calls):
            try:
                call = model(env.transcript, env.tools)
            except GameStopped as stopped:
                if not stopped.counts:
                    raise
                ended = str(stopped)
                break
            with simulation:
                _write_usage(folder, budget)
                env.begin(call)
                while env.action is not None:
                    env.step(env.action)
            if env.is_over:
                ended = "over"
                break
        with simulation:
            result = GameResult(number, env.score(), ended, **measure_game(env, rooms.config),
                                usage=getattr(model, "usage", Usage()))
            if folder is not None:
                save_games(folder / f"game-{number:03}.jsonl", [record_game(env)])
                write_json(folder / f"game-{number:03}.json", result.to_dict())
    return result


def _write_usage(folder: Path | None, budget: Budget) -> None:
    """Write what all games have used so far, which counts when they are resumed."""
    if folder is not None:
        write_json(folder / "usage.json", dataclasses.asdict(budget.spent))


def measure_game(env: TextEnv, config: RoomConfig | None = None) -> dict[str, float | None]:
    """Measure the errors of a game, exact and from actions, as arguments of `GameResult`; None where undefined.

    Args:
        env: the game.
        config: configuration of the room; by default the preset or rung of its name.
    """
    room, exact = env.instance, (None, None, None)
    with contextlib.suppress(UnsupportedError):
        errors = ErrorMeter(room, config).measure(env.start, env.decisions)
        exact = errors.exploration, errors.exploitation, errors.luck
    shares = estimate_errors(room, env.decisions) if isinstance(room.puzzle, ButtonsPuzzle) else (None, None)
    names = "exploration", "exploitation", "luck", "exploration_from_actions", "exploitation_from_actions"
    return dict(zip(names, (*exact, *shares), strict=True))


def _resume(folder: Path, settings: Mapping[str, Any], budget: Budget) -> dict[int, GameResult]:
    """Return the finished games of a folder, or begin one."""
    make_folder(folder)
    if not (folder / "settings.json").exists():
        write_json(folder / "settings.json", settings)
        return {}
    known = read_json(folder / "settings.json", "settings of games")
    if known != settings:
        different = sorted(key for key in settings if not isinstance(known, dict) or known.get(key) != settings[key])
        raise RunMismatchError(f"{folder} holds games with other settings ({', '.join(different)}): "
                               "take another folder")
    done = {}
    for path in [*folder.glob("usage.json"), *sorted(folder.glob("game-*.json"))]:
        value = read_json(path, "result of games")
        try:
            if path.name == "usage.json":
                budget.charge(read_record(Usage, value, "usage"))
            else:
                result = GameResult.from_dict(value)
                done[result.room] = result
        except (ConfigError, UnknownNameError) as error:
            raise FileReadError(f"{path} is damaged ({error}). Delete it to play the game again") from error
    return done
