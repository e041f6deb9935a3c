"""One run of a comparison: make the room, train the agent, keep its numbers and its last episodes.

`execute_run` leaves `run_result.json` once everything else is on disk, so a folder that has it is finished.
Which runs there are is `grid.py`; starting and watching them is `local.py`.
"""

from __future__ import annotations

import dataclasses
import platform
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.agent import Agent
from hrl_escape.agents.hierarchy_kinds import find_kind
from hrl_escape.agents.spec import AgentSpec, OptionsView
from hrl_escape.agents.text_agent import TEXT_AGENT
from hrl_escape.agents.training.evaluation import Evaluation, compute_episode_seed, evaluate, evaluate_trials
from hrl_escape.agents.training.results import TrainResult
from hrl_escape.benchmark.episodes import StateRecorder, find_recorder
from hrl_escape.benchmark.grid import GridRun
from hrl_escape.benchmark.recording import record_episode
from hrl_escape.benchmark.records import record_returns
from hrl_escape.benchmark.references.registry import make_reference
from hrl_escape.benchmark.score_range import ScoreRange, compute_score_range
from hrl_escape.benchmark.solved_probe import Solution, SolvedProbe
from hrl_escape.benchmark.statistics import compute_final, compute_mean_efficiency
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import RoomState
from hrl_escape.errors import EscapeError, FileReadError, describe_damage
from hrl_escape.files import read_json, write_json
from hrl_escape.sets.common_spaces import CommonSpaces, CommonSpacesEnv, join_spaces
from hrl_escape.sets.grammar import FreshRooms, NamedRooms
from hrl_escape.sets.instance_set import InstanceSet
from hrl_escape.sets.places import RunPlace, Split
from hrl_escape.sets.room_schedule import RoomSchedule
from hrl_escape.sets.room_sequence import RoomSequence, list_sets
from hrl_escape.sets.sequence import SequenceEnv, compute_room_seed
from hrl_escape.settings import read_record
from hrl_escape.version import __version__, find_versions


@dataclass(frozen=True)
class RunResult:
    """Result of one run; its `GridRun` says which."""

    budget: int  # primitives it was to train for; those it did train for where it ended early
    primitives: int  # trained for; a last option may carry it beyond the budget
    decisions: int  # trained for
    episodes: int  # trained for
    planner_calls: int  # behind options, in training
    first_escape: int | None
    """Primitives at the end of the first training episode that escaped; None if none did. A reference's are counted
    from its first evaluation episode."""
    evaluations: tuple[Evaluation, ...]  # the first before training, the last after it; of a reference, one
    score_range: ScoreRange  # best known and worst results, by which its scores are measured
    solution: Solution | None  # course towards the solution, in grids with `until_solved`
    seconds: tuple[float, ...] = dataclasses.field(compare=False)
    """Of training when each evaluation was made; left out of comparisons."""
    planner_seconds: float = dataclasses.field(compare=False)  # of training, in planners; left out of comparisons
    versions: Mapping[str, str] = dataclasses.field(compare=False)
    """Of the packages that made it; left out of comparisons."""
    seen: Evaluation | None = None  # last evaluation in rooms that were trained in, where others were tested in
    seen_range: ScoreRange | None = None  # its scale
    trials: tuple[Evaluation, ...] = ()
    """Evaluation of each trial at the end, over all test rooms, if rooms are tried several times."""
    trial_ranges: tuple[ScoreRange, ...] = ()  # their scales

    @classmethod
    def make(cls, budget: int, result: TrainResult, score_range: ScoreRange, solution: Solution | None) -> RunResult:
        """Sum up a finished training run."""
        return cls(budget, result.primitives, result.decisions, len(result.episodes), result.planner_calls,
                   result.first_escape, result.evaluations, score_range, solution,
                   tuple(result.curve(against="seconds")[0].tolist()), result.planner_seconds, list_versions())

    @classmethod
    def make_reference(cls, budget: int, evaluation: Evaluation, score_range: ScoreRange) -> RunResult:
        """Sum up the evaluation of a reference."""
        waited = np.cumsum(evaluation.lengths)
        escapes = [int(at) for at, success in zip(waited, evaluation.successes, strict=True) if success]
        return cls(budget, 0, 0, 0, 0, escapes[0] if escapes else None, (evaluation,), score_range, None, (0.0,), 0.0,
                   list_versions())

    def get_curve(self, metric: str) -> NDArray[np.float64]:
        """`primitives`, `decisions`, `seconds`, `efficiency` or a mean of `Evaluation`, at every evaluation."""
        if metric == "seconds":
            return np.array(self.seconds)
        if metric == "efficiency":
            return np.array([_compute_efficiency(found, self.score_range) for found in self.evaluations])
        return np.array([getattr(evaluation, metric) for evaluation in self.evaluations], dtype=np.float64)

    @property
    def seen_efficiency(self) -> float | None:
        """Efficiency at the end in rooms that were trained in; None without others to be tested in."""
        if self.seen is None or self.seen_range is None:
            return None
        return _compute_efficiency(self.seen, self.seen_range)

    @property
    def trial_efficiencies(self) -> NDArray[np.float64]:
        """Efficiency at the first, second, ... trial in rooms not seen before; empty without trials."""
        return np.array([_compute_efficiency(*scored) for scored in zip(self.trials, self.trial_ranges, strict=True)])

    def get_final(self, metric: str) -> float:
        """Mean of a curve over the last fifth of the budget; see `compute_final`."""
        return compute_final(self.get_curve("primitives"), self.get_curve(metric), self.budget)

    @property
    def is_stuck(self) -> bool:
        """No evaluation episode succeeded in the last fifth of the budget."""
        return self.get_final("success_rate") == 0.0


def _compute_efficiency(evaluation: Evaluation, score_range: ScoreRange) -> float:
    return compute_mean_efficiency(evaluation.escaped, evaluation.lengths, score_range.fewest,
                                   score_range.is_expected)


def make_agent_env(agent: AgentSpec, rooms: NamedRooms, observation: str,
             schedule: Mapping[str, int] | None = None, common: CommonSpaces | None = None, trials: int = 1
             ) -> tuple[gymnasium.Env, StateRecorder]:
    """The environment an agent acts in, and the recorder inside it; of a sequence the one in the first room.

    Every episode draws a room of a set, but for those in the schedule, whose numbers, by their seeds, go round the set,
    or each set of a sequence (see `RoomSchedule`). In `common` spaces rooms of several configurations look alike. An
    episode has several `trials` in the same room; see `SequenceEnv`.
    """
    import hrl_escape  # noqa: F401  # registers the environment

    schedule = schedule or {}
    if isinstance(rooms, RoomSequence):
        (first, recorder), *others = (
            make_agent_env(agent, each, observation,
                     {str(compute_room_seed(int(seed), place)): number for seed, number in schedule.items()}, common)
            for place, each in enumerate(rooms.sets))
        return SequenceEnv(first, then=[env for env, _ in others], paired=rooms.paired), recorder
    if isinstance(rooms, InstanceSet):
        flat = RoomSchedule(rooms.make_env(observation=observation),
                            {seed: number % len(rooms) for seed, number in schedule.items()})
    else:
        given: dict[str, Any] = {"config": rooms.config, "resample_instance": True} if isinstance(
            rooms, FreshRooms) else {"instance": rooms}
        flat = gymnasium.make("hrl_escape/EscapeRoom-v1", **given, observation=observation, disable_env_checker=True)
    recorder = StateRecorder(flat)
    if agent.low_level is not None:
        from hrl_escape.hierarchies.hierarchy_env import HierarchyEnv

        return HierarchyEnv(recorder, find_kind(agent.name), agent.low_level), recorder
    env = _add_options(agent, recorder, trials) if agent.chooses_options else _add_trials(recorder, trials)
    return (env if common is None else CommonSpacesEnv(env, *common)), recorder


def _add_trials(env: gymnasium.Env, trials: int) -> gymnasium.Env:
    return env if trials == 1 else SequenceEnv(env, trials)


def _add_options(agent: AgentSpec, recorder: StateRecorder, trials: int) -> gymnasium.Env:
    from hrl_escape.options.memory import DecisionMemory
    from hrl_escape.options.options_env import OptionsEnv  # brings the planners in

    arguments = agent.options.to_dict()
    has_memory = arguments.pop("memory")
    env: gymnasium.Env = OptionsEnv(recorder, trace=agent.needs_trace, **arguments)
    if agent.name == TEXT_AGENT:
        from hrl_escape.text.text_env import TextEnv

        env = TextEnv(env, agent.resolve_settings()["reveal"])
    env = _add_trials(env, trials)
    return DecisionMemory(env) if has_memory else env


def make_player(agent: AgentSpec, env: gymnasium.Env, recorder: StateRecorder) -> Agent:
    """Make an agent without training, a reference or the caller of tools, for an environment of `make_agent_env`."""
    if agent.name != TEXT_AGENT:
        return make_reference(agent.name, env, recorder)
    from hrl_escape.text.managers import ToolsAgent, make_model

    return ToolsAgent(env, make_model(agent.resolve_settings()["model"]))


def _find_common_spaces(agent: AgentSpec, split: Split, observation: str) -> CommonSpaces | None:
    """Spaces of rooms to train in and to be tested in together; None where they are the same already."""
    if not split.is_transfer or (agent.is_reference and not isinstance(split.test, RoomSequence)):
        return None
    envs = [make_agent_env(agent, rooms, observation)[0] for rooms in split.sets]
    try:
        return join_spaces(envs)
    finally:
        for env in envs:
            env.close()


def execute_run(run: GridRun, out: Path, checkpoint_seconds: float) -> None:
    """Bring a run to its end, from where it was last stopped, in the comparison's folder, which holds the room."""
    folder, place = get_run_folder(out, run), RunPlace.load(out / "rooms", run.place_id)
    agent, grid = run.agent, run.grid
    seeds = [compute_episode_seed(run.eval_seed, "evaluation", n) for n in range(grid.eval_episodes)]
    order = {str(seed): n for n, seed in enumerate(seeds)}
    common = _find_common_spaces(agent, place.split, grid.observation) if place.split else None
    rooms = place.split.test if place.split else place.instance
    floors = 1 if isinstance(rooms, RoomInstance) else len(list_sets(rooms))
    env, recorder = make_agent_env(agent, rooms, grid.observation, order, common)
    try:
        starts = find_starts(env, recorder, seeds)
        score_range = compute_score_range(starts, agent, out / "references", floors)
        if agent.is_reference:
            player: Agent = make_player(agent, env, recorder)
            evaluation = evaluate(player, env, len(seeds), run.eval_seed, grid.primitives, trials=floors)
            value = RunResult.make_reference(grid.primitives, evaluation, score_range)
        elif place.split is None:
            player, value = _train(run, out, env, env, place, score_range, checkpoint_seconds)
        else:
            player, value = _train_in_set(run, out, env, place, common, score_range, checkpoint_seconds)
        record_returns(starts, score_range.best, value.evaluations, run.source)
        if grid.trials > 1 and place.split is not None:
            value = _try_several_times(run, out, player, place.split, common, order, value)
        drawn = seeds if place.split is None else seeds[:: len(place.split.test)]  # those in the room in pictures
        episodes = [] if floors > 1 else [record_episode(player, env, seed).to_json() for seed in drawn]
    finally:
        env.close()
    write_json(folder / "episodes.json", episodes, indent=None)
    write_json(folder / "run_result.json", {"identity": run.identity, "result": dataclasses.asdict(value)}, indent=None)


def _train_in_set(run: GridRun, out: Path, eval_env: gymnasium.Env, place: RunPlace, common: CommonSpaces | None,
                  score_range: ScoreRange, checkpoint_seconds: float) -> tuple[Agent, RunResult]:
    """Train in one set of rooms, with evaluations in another, and evaluate in rooms of the first at the end."""
    assert place.split is not None
    seeds = [compute_episode_seed(run.eval_seed, "evaluation", n) for n in range(run.grid.eval_episodes)]
    order, floors = {str(seed): n for n, seed in enumerate(seeds)}, len(list_sets(place.split.train))
    env, _ = make_agent_env(run.agent, place.split.train, run.grid.observation, common=common, trials=run.grid.trials)
    again, again_recorder = make_agent_env(run.agent, place.split.train, run.grid.observation, order, common)
    try:
        agent, value = _train(run, out, env, eval_env, place, score_range, checkpoint_seconds)
        starts = find_starts(again, again_recorder, seeds)
        seen_range = compute_score_range(starts, run.agent, out / "references", floors)
        seen = evaluate(agent, again, len(seeds), run.eval_seed, value.primitives, value.decisions, trials=floors)
        record_returns(starts, seen_range.best, [seen], run.source)
    finally:
        env.close()
        again.close()
    return agent, dataclasses.replace(value, seen=seen, seen_range=seen_range)


def _try_several_times(run: GridRun, out: Path, player: Agent, split: Split, common: CommonSpaces | None,
                       order: Mapping[str, int], value: RunResult) -> RunResult:
    """Evaluate every trial of episodes with several in the rooms to be tested in."""
    trials, starts = run.grid.trials, []
    env, recorder = make_agent_env(run.agent, split.test, run.grid.observation, order, common, trials)
    room: Any = env.unwrapped
    if run.agent.is_reference:
        player = make_player(run.agent, env, recorder)
    try:
        found = evaluate_trials(
            player, env, run.grid.eval_episodes, trials, run.eval_seed, value.primitives, value.decisions,
            lambda: starts.append([(room.instance, state) for state in recorder.starts]))
    finally:
        env.close()
    tried = list(zip(*starts, strict=True))
    ranges = tuple(compute_score_range(trial, run.agent, out / "references") for trial in tried)
    for trial, score_range, evaluation in zip(tried, ranges, found, strict=True):
        record_returns(trial, score_range.best, [evaluation], run.source)
    return dataclasses.replace(value, trials=found, trial_ranges=ranges)


def _train(run: GridRun, out: Path, env: gymnasium.Env, eval_env: gymnasium.Env, place: RunPlace,
           score_range: ScoreRange, checkpoint_seconds: float) -> tuple[Agent, RunResult]:
    from hrl_escape.agents.training.train import train

    rule = run.grid.until_solved
    probe = None if rule is None else SolvedProbe(rule, env, place.instance, run.agent, score_range)
    # `run.settings` and the environment hold the rest of the spec.
    chosen = OptionsView(include_primitives=run.agent.options.include_primitives)
    result = train(
        AgentSpec(run.agent.name, options=chosen), env, primitives=run.grid.primitives,
        decisions=run.grid.decisions, seed=run.seed, settings=run.settings, eval_env=eval_env,
        eval_every=run.grid.evaluation_step,
        eval_episodes=run.grid.eval_episodes, eval_seed=run.eval_seed, out=get_training_folder(out, run),
        checkpoint_seconds=checkpoint_seconds, progress=False, probe=probe,
        eval_trials=1 if place.split is None else len(list_sets(place.split.test)), observed=False,
    )
    assert result.agent is not None, "a run that this process finished or loaded has its agent"
    solution = None if probe is None else probe.solution
    budget = min(run.grid.primitives, result.primitives)
    return result.agent, RunResult.make(budget, result, score_range, solution)


def find_starts(env: gymnasium.Env, recorder: StateRecorder, seeds: Sequence[int]
                 ) -> list[tuple[RoomInstance, RoomState]]:
    """Room and first state of the episodes of these seeds; of a sequence those of every room."""
    if isinstance(env, SequenceEnv):
        return [start for seed in seeds for place, part in enumerate(env.parts)
                for start in find_starts(part, find_recorder(part), [compute_room_seed(seed, place)])]
    room: Any = env.unwrapped
    starts = []
    for seed in seeds:
        env.reset(seed=seed)
        starts.append((room.instance, recorder.states[0]))
    return starts


def load_run_result(out: Path, run: GridRun) -> RunResult | None:
    """The result of a finished run, None if it is not finished; `FileReadError` where it is damaged or another's."""
    path = get_run_folder(out, run) / "run_result.json"
    if not path.exists():
        return None
    value = read_json(path, "result of a run")
    try:
        if value["identity"] != run.identity:
            raise FileReadError(f"{path}: this result belongs to another run than its folder's name says")
        return read_record(RunResult, value["result"])
    except FileReadError:
        raise
    except (EscapeError, KeyError, TypeError, AttributeError) as error:
        raise FileReadError(f"{path}: this result of a run is damaged ({describe_damage(error)})") from error


def read_episodes(out: Path, run: GridRun) -> list[dict[str, Any]]:
    """The recorded episodes of a finished run, see `record_episode`; `FileReadError` where they are missing."""
    return read_json(get_run_folder(out, run) / "episodes.json", "record of episodes")


def list_versions() -> dict[str, str]:
    """Versions of what decides the numbers."""
    return {"python": platform.python_version(), "hrl-escape": __version__, **find_versions()}


def get_run_folder(out: Path, run: GridRun) -> Path:
    """Folder of a run's files."""
    return out / "runs" / run.folder


def get_training_folder(out: Path, run: GridRun) -> Path:
    """Folder of a run's training: log, checkpoint and result."""
    return get_run_folder(out, run) / "training"


def get_room_file(out: Path, instance_id: str) -> Path:
    """File of a room."""
    return out / "rooms" / f"{instance_id}.json"
