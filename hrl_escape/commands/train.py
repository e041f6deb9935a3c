"""Train an agent in rooms or in another environment, with a log and checkpoints; a stopped run resumes.

    hrl-escape train smdp-dqn
    hrl-escape train smdp-r-max
    hrl-escape train smdp-ppo+objects+memory --room clutter#3 --primitives 50000
    hrl-escape train smdp-dqn --room ladder-1/pair/train#0..64
    hrl-escape train smdp-dqn --settings gamma=0.995 hidden=[128,128]
    hrl-escape train smdp-dqn --list-settings
    hrl-escape train dqn@keras-rl-2019 --room paper-two-button --seed 7 --json
    hrl-escape train maxq-q+planned
    hrl-escape train ppo --num-envs 1024 --primitives 5000000
    hrl-escape train dac --num-envs 64 --primitives 500000
    hrl-escape train hiro --room continuous-four-rooms --num-envs 256
    hrl-escape train text-agent --settings model=search-random reveal=names --primitives 2000
    hrl-escape train smdp-iql --data pair-play-v1
    hrl-escape train dqn --env CartPole-v1 --primitives 50000
    hrl-escape train smdp-dqn --env MiniGrid-DoorKey-8x8-v0 --options my_options.py:make

`hrl-escape list agents parts` lists the agents and the parts of their specs. The prefix smdp- chooses among options,
and +primitives adds the primitives. `hrl-escape list recommended` lists agents to begin with.
"""

from __future__ import annotations

import dataclasses
import json
import sys
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import gymnasium
import tyro
from rich.console import Console
from rich.table import Table

from hrl_escape.agents.agent import Agent
from hrl_escape.agents.hierarchy_kinds import find_kind
from hrl_escape.agents.registry import get_recipe, join_name, list_hierarchy_agents
from hrl_escape.agents.spec import AgentSpec, OptionsView
from hrl_escape.agents.text_agent import TEXT_AGENT, TextAgentSettings
from hrl_escape.agents.training.callbacks import TensorBoard
from hrl_escape.agents.training.evaluation import compute_episode_seed
from hrl_escape.agents.training.results import TrainResult
from hrl_escape.agents.training.train import train
from hrl_escape.benchmark.agent_env import find_starts, make_agent_env, make_player
from hrl_escape.benchmark.episodes import StateRecorder
from hrl_escape.benchmark.records import record_returns
from hrl_escape.commands.agent_choice import AgentChoice
from hrl_escape.commands.env_choice import EnvChoice
from hrl_escape.commands.room_choice import RoomChoice, refuse_options
from hrl_escape.env.instance import RoomInstance
from hrl_escape.errors import UnsupportedError
from hrl_escape.names import make_console_text, make_file_name
from hrl_escape.planning.best_known import best_known_return, find_best_known
from hrl_escape.sets.environments import list_batch_arguments
from hrl_escape.sets.grammar import NamedRooms
from hrl_escape.sets.places import RunPlace
from hrl_escape.settings import read_field_documents

if TYPE_CHECKING:
    from gymnasium.vector import VectorEnv

    from hrl_escape.agents.many_envs import ManyEnvs

SHOWN_EVALUATIONS, PRIMITIVES = 12, 20_000
OF_OPTIONS = ("option_set",)
OF_ENVS = tuple(field.name for field in dataclasses.fields(EnvChoice))
OF_ROOMS = (*(field.name for field in dataclasses.fields(RoomChoice)), "num_envs", "device", "compile", *OF_OPTIONS)


@dataclasses.dataclass(frozen=True)
class TrainArgs(AgentChoice, EnvChoice, RoomChoice):
    """Options of `hrl-escape train`."""

    agent: Annotated[str, tyro.conf.Positional] = "smdp-dqn"
    """Spec of the agent, such as smdp-ppo+objects+memory; the prefix smdp- makes it choose among options."""
    primitives: int | None = None
    """Training budget in primitives; 20,000 by default, with --data the agent's number of passes."""
    data: str | None = None
    """Data set or recording for offline training; tests are in unseen rooms of its rung. See `hrl-escape list
    offline`."""
    seed: int = 0
    """Training seed: fixes the agent and every training episode. Give --room or --env too: --seed alone chose a room
    in 0.3."""
    list_settings: bool = False
    """Print the agent's settings and exit."""
    eval_every: int | None = None
    """Primitives between evaluations; a twentieth of the budget by default."""
    eval_episodes: int = 5
    """Episodes in an evaluation."""
    num_envs: int | None = None
    """Number of copies of the room on the batched engine, or of --env by `gymnasium.make_vec`; for the agents of
    `hrl-escape list batched`."""
    device: str = "cpu"
    """Device of copies and networks, such as cuda; with --num-envs."""
    compile: bool = False
    """Compile the step of the copies: half a minute once, then several times as fast; with --num-envs."""
    out: Path | None = None
    """Folder of log, checkpoint and result; runs/AGENT-ROOM-SEED-HASH by default."""
    tensorboard: bool = False
    """Also write TensorBoard's files (extra `tensorboard`)."""
    threads: int = 1
    """Threads of torch, a part of the run's identity: one is fastest for small networks, all cores for many copies."""
    quiet: bool = False
    """Show no progress line."""
    json: bool = False
    """Print the result as JSON."""

    def make_batch(self, spec: AgentSpec, rooms: NamedRooms) -> VectorEnv | ManyEnvs:
        """Make copies of the room, or of the rooms of a set, for training."""
        assert self.num_envs is not None
        given = list_batch_arguments(rooms)
        observation = self.choose_observation(spec)
        if spec.low_level is not None or not spec.chooses_options:
            from hrl_escape.env.continuous_vector_env import EscapeRoomContinuousVectorEnv
            from hrl_escape.env.vector_env import EscapeRoomVectorEnv

            kind = EscapeRoomContinuousVectorEnv if spec.drives_velocities else EscapeRoomVectorEnv
            flat = kind(self.num_envs, **given, observation=observation, output="torch", device=self.device,
                        compile=self.compile)
            if spec.low_level is None:
                return flat
            from hrl_escape.hierarchies import HierarchyVectorEnv

            return HierarchyVectorEnv(flat, find_kind(spec.name), spec.low_level)
        from hrl_escape.options.batched.env import BatchedOptionsEnv
        from hrl_escape.options.memory import VectorDecisionMemory

        gamma = spec.resolve_settings()["gamma"]
        options = BatchedOptionsEnv(self.num_envs, **given, observation=observation, discount=gamma,
                                    include_primitives=spec.options.include_primitives,
                                    option_set=spec.options.option_set, device=self.device, compile=self.compile)
        return VectorDecisionMemory(options) if spec.options.memory else options


def run(args: TrainArgs) -> None:
    """Train and evaluate an agent, and print its learning curve."""
    spec = args.make_spec(args.agent)
    if spec.is_reference and spec.name != TEXT_AGENT:
        raise UnsupportedError(f"{spec.name} learns nothing: `hrl-escape watch {spec.name}` shows it, and `hrl-escape "
                               "compare` holds learners against it")
    resolved = spec.resolve_settings()
    if args.list_settings:
        _print_settings(args, spec, resolved)
        return
    if args.data is not None:
        refuse_options(args, (*OF_ENVS, *OF_ROOMS), "does not go with --data, whose rooms and options are those of "
                       f"{args.data}")
        if spec.options not in (OptionsView(), OptionsView(include_primitives=True)) or spec.low_level is not None:
            raise UnsupportedError(f"{spec.label} does not go with --data, whose rooms and options are those of "
                                   f"{args.data}: name {spec.name}")
        _train_offline(args, spec)
        return
    if (chosen := args.make_env_spec()) is not None:
        of_rooms = tuple(name for name in (*OF_ROOMS, "observation") if name != "num_envs")
        refuse_options(args, of_rooms, f"does not go with --env: {args.env} has its own observations and actions, and "
                       "--options are its options")
        single = chosen.make_agent_env(spec)
        with closing(single):
            made = single if args.num_envs is None else chosen.make_many(spec, args.num_envs)
            _tell(args, spec, _train(args, spec, made, chosen.name), None)
        return
    if not spec.chooses_options:
        refuse_options(args, OF_OPTIONS, "is for agents that choose among options, such as "
                       f"{join_name(spec.algorithm, True)}")
    if spec.low_level is None and spec.algorithm in list_hierarchy_agents():
        acts = "options" if spec.chooses_options else "primitives"
        print(f"{spec.name} is given no hierarchy: it learns over {acts}, as one task. {spec.algorithm}+planned and "
              f"{spec.algorithm}+learned give it one", file=sys.stderr)
    rooms = args.find_rooms()
    place = RunPlace.of_room(rooms).name if isinstance(rooms, RoomInstance) else rooms.name
    recorder: StateRecorder | None = None
    player: Agent | None = None
    if args.num_envs is None:
        refuse_options(args, ("compile", "device"), "is for many copies of the room: give --num-envs N; one room is "
                       "stepped by Bullet, on the CPU")
        env, recorder = make_agent_env(spec, rooms, args.choose_observation(spec))
        player = make_player(spec, env, recorder) if spec.name == TEXT_AGENT else None
    else:
        env = args.make_batch(spec, rooms)
    result = _train(args, player or spec, env, place, observed=recorder is None)
    planned = rooms if isinstance(rooms, RoomInstance) and not spec.drives_velocities else None
    if isinstance(env, gymnasium.Env) and recorder is not None and planned is not None:
        _record(env, recorder, result, f"{spec.label}, seed {args.seed}")
    if isinstance(env, (gymnasium.Env, gymnasium.vector.VectorEnv)):
        env.close()
    _tell(args, spec, result, None if planned is None else best_known_return(planned))


def _train(args: TrainArgs, agent: AgentSpec | Agent, env: gymnasium.Env | VectorEnv | ManyEnvs | None, place: str,
           **given: Any) -> TrainResult:
    """Train in the run's folder, by default one named by agent, place and seed."""
    primitives = PRIMITIVES if args.primitives is None and args.data is None else args.primitives
    name = make_file_name(f"{args.make_spec(args.agent).label}-{place}-{args.seed}")
    return train(agent, env, primitives=primitives, seed=args.seed, eval_every=args.eval_every,
                 eval_episodes=args.eval_episodes, out=args.out or Path("runs") / f"{name}-{{key}}",
                 callbacks=[TensorBoard()] if args.tensorboard else [], threads=args.threads,
                 progress=False if args.quiet else None, **given)


def _train_offline(args: TrainArgs, spec: AgentSpec) -> None:
    """Train from a data set and print the curve."""
    from hrl_escape.data.materialise import load_data

    data = load_data(args.data or "", observation=args.choose_observation(spec))
    result = _train(args, spec, None, data.name, data=data)
    _tell(args, spec, result, data.recording.about["scores"].get("best_known"))


def _record(env: gymnasium.Env, recorder: StateRecorder, result: TrainResult, source: str) -> None:
    """Raise the best known returns that an evaluation has beaten."""
    episodes = len(result.evaluations[0].returns) if result.evaluations else 0
    starts = find_starts(env, recorder, [compute_episode_seed(0, "evaluation", n) for n in range(episodes)])
    record_returns(starts, [find_best_known(*start).value for start in starts], result.evaluations, source)


def _print_settings(args: TrainArgs, spec: AgentSpec, resolved: dict[str, Any]) -> None:
    kind = TextAgentSettings if spec.name == TEXT_AGENT else type(get_recipe(spec.name, spec.recipe))
    documents = read_field_documents(kind)
    if args.json:
        print(json.dumps({name: {"value": value, "about": documents.get(name, "")} for name, value in resolved.items()},
                         indent=2))
        return
    table = Table("setting", "value", "", box=None, padding=(0, 2, 0, 0), header_style="dim")
    for name, value in resolved.items():
        table.add_row(name, json.dumps(value), documents.get(name, ""))
    Console().print(table)


def _tell(args: TrainArgs, spec: AgentSpec, result: TrainResult, best: float | None) -> None:
    if args.json:
        print(json.dumps({"best_known": best, "folder": str(result.folder), **result.to_json()}, indent=2))
        return
    console = Console(soft_wrap=True, highlight=False)
    table = Table(box=None, padding=(0, 2, 0, 0), header_style="dim")
    for heading in ("primitives", "decisions", "return", "success rate", "primitives an episode"):
        table.add_column(heading, justify="right")
    evaluations = result.evaluations
    step = max(1, -(-len(evaluations) // SHOWN_EVALUATIONS))
    for number, evaluation in enumerate(evaluations):
        if number % step == 0 or number == len(evaluations) - 1:
            table.add_row(f"{evaluation.primitives:,}", f"{evaluation.decisions:,}", f"{evaluation.mean_return:.1f}",
                          "" if evaluation.success_rate is None else f"{evaluation.success_rate:.0%}",
                          f"{evaluation.mean_length:,.0f}")
    console.print(table)
    episodes = len(result.episodes) + sum(segment.episodes for segment in result.segments)
    calls = f", {result.planner_calls:,} planner calls" if result.planner_calls else ""
    if result.resumed_at:
        budget = args.primitives or (PRIMITIVES if args.data is None else result.primitives)
        done = "was finished: nothing was trained" if result.resumed_at >= result.primitives else (
            f"resumed at {result.resumed_at:,} of {budget:,} primitives")
        console.print(f"this run {done}")
    console.print(f"[bold]{make_console_text(spec.label)}[/bold], seed {result.seed}: {result.primitives:,} "
                  f"primitives, {result.decisions:,} decisions, {episodes:,} episodes{calls}, "
                  f"{result.seconds:.1f} s of training")
    if evaluations:
        known = "" if best is None else f"; the best known is {best:g}"
        console.print(f"return {evaluations[-1].mean_return:.1f} at the end{known}")
        top = max(evaluations, key=lambda evaluation: evaluation.mean_return)
        console.print(f"best evaluation: return {top.mean_return:.1f} after {top.primitives:,} primitives; best.npz "
                      "keeps its agent")
    console.print(f"log, checkpoints and result: {result.folder}", markup=False)
