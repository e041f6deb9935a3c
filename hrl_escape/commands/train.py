"""Train one agent in one room, or many seeds at once: curve, log, checkpoints; goes on where it was stopped.

    hrl-escape train smdp-dqn
    hrl-escape train smdp-ppo --preset clutter --seed 3 --primitives 50000 --out runs/clutter-ppo
    hrl-escape train smdp-dqn --settings gamma=0.995 hidden=[128,128]
    hrl-escape train smdp-dqn --list-settings
    hrl-escape train dqn --recipe paper --training-seed 7 --json
    hrl-escape train smdp-dqn --trials 16 --workers 2

`hrl-escape list agents` names the agents; with smdp- in front they choose options beside primitives.
"""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Annotated, Any, Literal

import torch
import tyro
from rich.console import Console
from rich.table import Table

from hrl_escape.agents.registry import get_recipe
from hrl_escape.agents.results import TrainResult
from hrl_escape.agents.settings import read_field_documents
from hrl_escape.agents.training import train
from hrl_escape.commands.room_choice import RoomChoice, split_assignment
from hrl_escape.env.instance import RoomInstance
from hrl_escape.errors import ConfigError, RunMismatchError
from hrl_escape.experiments.cell import make_env
from hrl_escape.experiments.grid import AgentSpec, OptionsView, name_room
from hrl_escape.options.best_known import best_known_return

SHOWN_EVALUATIONS = 12


@dataclasses.dataclass(frozen=True)
class TrainArgs(RoomChoice):
    """Options of `hrl-escape train`."""

    agent: Annotated[str, tyro.conf.Positional] = "smdp-dqn"
    """Which agent; smdp- in front for one that chooses options."""
    primitives: int = 20_000
    """Training budget."""
    training_seed: int = 0
    """Fixes the agent and every training episode."""
    trials: Annotated[int, tyro.conf.arg(metavar="N")] = 1
    """Train so many seeds at once, the training seed and those after it (dqn, sarsa, q-learning)."""
    workers: int = 1
    """Processes that share the trials; one a core is fastest."""
    recipe: str = "corrected"
    """Where its settings come from: corrected, or paper."""
    settings: tuple[str, ...] = ()
    """Settings to change, as name=value; --list-settings shows them."""
    list_settings: bool = False
    """Print the agent's settings and what they mean, and train nothing."""
    options_only: bool = False
    """Leave the primitives out of an smdp- agent's choices."""
    flavour: Literal["press", "press-with-ancestors"] = "press"
    """What its meta-actions do: press one button, or first those that must be on before it."""
    observation: Literal["features", "state", "egocentric"] = "features"
    """What the agent sees."""
    eval_every: int | None = None
    """Primitives between evaluations; a twentieth of the budget by default."""
    eval_episodes: int = 5
    """Episodes in an evaluation."""
    out: Path | None = None
    """Folder of log, checkpoint and result; runs/AGENT-ROOM-SEED by default. Trials have a folder each in it."""
    tensorboard: bool = False
    """Also write TensorBoard's files (extra `tensorboard`)."""
    threads: int = 1
    """Threads for torch; small networks are quickest, and repeatable, with one."""
    json: bool = False
    """Print the result as JSON."""

    def make_spec(self) -> AgentSpec:
        """The agent that is asked for."""
        options = OptionsView(include_primitives=not self.options_only, flavour=self.flavour)
        settings = dict(split_assignment(text, "--settings", "gamma=0.95") for text in self.settings)
        return AgentSpec(name=self.agent, recipe=self.recipe, settings=settings, options=options)


def run(args: TrainArgs) -> None:
    """Train, and say how it went."""
    spec = args.make_spec()
    resolved = spec.resolve_settings()
    if args.list_settings:
        _print_settings(args, resolved)
        return
    if args.threads < 1:
        raise ConfigError("threads", args.threads, "it must be a whole number, 1 or more")
    torch.set_num_threads(args.threads)
    instance = args.make_instance()
    last = args.training_seed + args.trials - 1
    seeds = str(args.training_seed) if args.trials == 1 else f"{args.training_seed}-to-{last}"
    out = args.out or Path("runs") / f"{spec.label}-{name_room(instance)}-{seeds}"
    _claim(out, instance)
    asked: dict[str, Any] = {
        "primitives": args.primitives, "seed": args.training_seed, "settings": resolved, "eval_every": args.eval_every,
        "eval_episodes": args.eval_episodes, "out": out, "tensorboard": args.tensorboard, "workers": args.workers,
    }
    if args.trials != 1:
        results = train(args.agent, lambda: make_env(spec, instance, args.observation)[0], trials=args.trials,
                        **asked)
        best = best_known_return(instance)
        if args.json:
            trials = [result.to_json() for result in results]
            print(json.dumps({"best_known": best, "folder": str(out), "trials": trials}, indent=2))
        else:
            _print_trials(results, best, out)
        return
    env, _ = make_env(spec, instance, args.observation)
    result = train(args.agent, env, **asked)
    env.close()
    best = best_known_return(instance)
    if args.json:
        print(json.dumps({"best_known": best, "folder": str(out), **result.to_json()}, indent=2))
    else:
        _print(result, best, out)


def _claim(out: Path, instance: RoomInstance) -> None:
    """Keep the room beside the run, and refuse a folder that holds a run in another one."""
    path = out / "room.json"
    if path.exists():
        found = RoomInstance.load(path)
        if found.id != instance.id:
            raise RunMismatchError(f"{out} holds a run in room {found.id} ({name_room(found)}), this one is "
                                   f"{instance.id}. Choose another folder, or delete this one")
    else:
        instance.save(path)


def _print_settings(args: TrainArgs, resolved: dict[str, Any]) -> None:
    documents = read_field_documents(type(get_recipe(args.agent, args.recipe)))
    if args.json:
        print(json.dumps({name: {"value": value, "about": documents.get(name, "")} for name, value in resolved.items()},
                         indent=2))
        return
    table = Table(box=None, padding=(0, 2, 0, 0), header_style="dim")
    for heading in ("setting", "value", ""):
        table.add_column(heading)
    for name, value in resolved.items():
        table.add_row(name, json.dumps(value), documents.get(name, ""))
    Console().print(table)


def _print(result: TrainResult, best: float, out: Path) -> None:
    console = Console(soft_wrap=True, highlight=False)
    table = Table(box=None, padding=(0, 2, 0, 0), header_style="dim")
    for heading in ("primitives", "decisions", "return", "escapes", "primitives an episode"):
        table.add_column(heading, justify="right")
    evaluations = result.evaluations
    step = max(1, -(-len(evaluations) // SHOWN_EVALUATIONS))
    for number, evaluation in enumerate(evaluations):
        if number % step == 0 or number == len(evaluations) - 1:
            table.add_row(f"{evaluation.primitives:,}", f"{evaluation.decisions:,}", f"{evaluation.mean_return:.1f}",
                          f"{evaluation.success_rate:.0%}", f"{evaluation.mean_length:,.0f}")
    console.print(table)
    calls = f", {result.planner_calls:,} planner calls" if result.planner_calls else ""
    console.print(f"[bold]{result.agent_name}[/bold], seed {result.seed}: {result.primitives:,} primitives, "
                  f"{result.decisions:,} decisions, {len(result.episodes):,} episodes{calls}, "
                  f"{result.seconds:.1f} s of training")
    if evaluations:
        console.print(f"return {evaluations[-1].mean_return:.1f} at the end; the best known is {best:g}")
    console.print(f"log, checkpoint and result: {out}")


def _print_trials(results: list[TrainResult], best: float, out: Path) -> None:
    console = Console(soft_wrap=True, highlight=False)
    table = Table(box=None, padding=(0, 2, 0, 0), header_style="dim")
    for heading in ("seed", "primitives", "decisions", "episodes", "return", "escapes", "seconds"):
        table.add_column(heading, justify="right")
    for result in results:
        last = result.evaluations[-1] if result.evaluations else None
        table.add_row(str(result.seed), f"{result.primitives:,}", f"{result.decisions:,}", f"{len(result.episodes):,}",
                      *((f"{last.mean_return:.1f}", f"{last.success_rate:.0%}") if last else ("", "")),
                      f"{result.seconds:.1f}")
    console.print(table)
    console.print(f"[bold]{results[0].agent_name}[/bold]: {len(results)} seeds; the best known return is {best:g}")
    console.print(f"log, checkpoint and result of each: {out}/seed-N")
