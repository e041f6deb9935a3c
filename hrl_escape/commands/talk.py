"""Evaluate a language model in rooms, through any OpenAI-compatible chat endpoint with tools.

    hrl-escape talk --model my-model --endpoint http://localhost:8000/v1
    hrl-escape talk --model my-model --endpoint https://host/v1 --room ladder-1/chain-3/test#0..10 --out games/my-model
    hrl-escape talk --me --room ladder-1/pair/test#0..3
    hrl-escape talk --games episodes/game-*.jsonl

The key is read from the environment and written nowhere. Every game is recorded in --out, and the same command resumes.
`--games` prints the row of recorded games, such as those of `hrl-escape play --hidden` and `hrl-escape mcp`.
The last lines of the output are the row of the caller. A model requires the extra `llm`.
"""

from __future__ import annotations

import dataclasses
import os
from pathlib import Path

from rich.console import Console

from hrl_escape.agents.text_agent import Level
from hrl_escape.errors import ConfigError, UnsupportedError
from hrl_escape.names import make_console_text, make_file_name


@dataclasses.dataclass(frozen=True)
class TalkArgs:
    """Options of `hrl-escape talk`."""

    model: str = ""
    """Name of the model at the endpoint."""
    endpoint: str = ""
    """Address up to /v1."""
    me: bool = False
    """Play yourself, by the text that a model reads."""
    games: tuple[Path, ...] = ()
    """Files of recorded games to replay instead; they give one row."""
    room: str = "ladder-1/pair/test#0..10"
    """Rooms, one game each: a set, or some rooms of it."""
    reveal: Level = "places"
    """Information for the caller: names, places or model."""
    primitives: bool = False
    """Offer primitives as well as options."""
    episode_seed: int = 0
    """Episode seed of every game."""
    out: Path | None = None
    """Folder of results and recordings; in games/, named by caller, rooms and reveal, by default."""
    key_variable: str = "OPENAI_API_KEY"
    """Environment variable with the key; without it no key is sent."""
    at_once: int = 4
    """Games that wait for replies at the same time."""
    most_calls: int = 200
    """Most calls in a game."""
    budget_tokens: int | None = None
    """Most tokens of all games, read and written."""
    budget_dollars: float | None = None
    """Most dollars of all games, at the prices below."""
    price_read: float = 0.0
    """Dollars per million tokens that the model reads."""
    price_written: float = 0.0
    """Dollars per million tokens that the model writes."""
    minutes: float | None = None
    """Most minutes of all games."""
    request_seconds: float = 120.0
    """Longest request in seconds."""
    retries: int = 5
    """Most retries of a request, with growing pauses."""
    temperature: float | None = None
    """Temperature of the model; the endpoint's own by default."""


def run(args: TalkArgs) -> None:
    """Play the games and print the row."""
    from hrl_escape.benchmark.models import GameResult, evaluate_model, evaluate_recordings
    from hrl_escape.text.chat import Budget, ChatClient
    from hrl_escape.text.person import Person

    console = Console(soft_wrap=True, highlight=False)
    if args.games:
        console.print(evaluate_recordings(args.model or "recorded", args.games).describe(), markup=False)
        return
    if args.me and (args.model or args.endpoint):
        raise UnsupportedError("--me plays without a model: leave --model and --endpoint out")
    if not args.me and not (args.model and args.endpoint):
        raise ConfigError("--model and --endpoint", f"{args.model!r} and {args.endpoint!r}",
                          "both given, or --me to play yourself")
    client = Person("person") if args.me else ChatClient(
        args.model, args.endpoint, os.environ.get(args.key_variable) or None, args.request_seconds, args.retries,
        options={} if args.temperature is None else {"temperature": args.temperature})
    budget = Budget(args.budget_tokens, args.budget_dollars, None if args.minutes is None else 60 * args.minutes,
                    (args.price_read, args.price_written))
    out = args.out or Path("games") / make_file_name(f"{client.name}-{args.room}-{args.reveal}")

    def tell(result: GameResult) -> None:
        score = result.score
        how = "escaped" if score.escaped else "did not escape" if result.ended == "over" else result.ended
        console.print(f"room {result.room}: {make_console_text(how)}, efficiency {score.efficiency:.2f}, "
                      f"{score.primitives} primitives, {score.decisions} calls, {score.invalid_calls} wrong")

    found = evaluate_model(client, args.room, args.reveal, seed=args.episode_seed, include_primitives=args.primitives,
                           games_at_once=args.at_once, most_calls=args.most_calls, budget=budget, out=out, on_game=tell)
    for room, reason in found.unfinished.items():
        console.print(f"room {room}: not finished: {make_console_text(reason)}")
    if found.unfinished:
        console.print(f"{len(found.games)} games are finished. The same command resumes.")
    console.print(found.describe(), markup=False)
