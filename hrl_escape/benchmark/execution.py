"""Execution of one run of a comparison: make the room, train the agent, evaluate it, record its last episodes.

`run_result.json` is written last, so a folder that has it is a finished run.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import gymnasium

from hrl_escape.agents.agent import Agent
from hrl_escape.agents.making import make_agent
from hrl_escape.agents.spec import AgentSpec, OptionsView
from hrl_escape.agents.training.evaluation import compute_episode_seed, evaluate, evaluate_trials
from hrl_escape.benchmark.agent_env import find_starts, make_agent_env, make_player
from hrl_escape.benchmark.env_spec import EnvSpec
from hrl_escape.benchmark.grid import GridRun
from hrl_escape.benchmark.recording import record_episode
from hrl_escape.benchmark.records import record_returns
from hrl_escape.benchmark.references.registry import TRAINED_IN_ROOM, TRAINED_IN_SET
from hrl_escape.benchmark.run_results import RunResult, get_run_folder, get_training_folder
from hrl_escape.benchmark.score_range import ScoreRange, compute_score_range
from hrl_escape.env.instance import RoomInstance
from hrl_escape.files import write_json
from hrl_escape.sets.common_spaces import CommonSpaces, join_spaces
from hrl_escape.sets.places import RunPlace, Split
from hrl_escape.sets.room_sequence import RoomSequence, list_sets


def execute_run(run: GridRun, out: Path, checkpoint_seconds: float) -> None:
    """Execute a run of a comparison, or resume it.

    Args:
        run: the run.
        out: folder of the comparison, which holds the room.
        checkpoint_seconds: time between checkpoints.
    """
    if run.grid.env is not None:
        _finish(run, out, _execute_in_env(run, run.grid.env, out, checkpoint_seconds), [])
        return
    place, agent, grid = RunPlace.load(out / "rooms", run.place_id), run.agent, run.grid
    seeds = [compute_episode_seed(run.eval_seed, "evaluation", n) for n in range(grid.eval_episodes)]
    order = {str(seed): n for n, seed in enumerate(seeds)}
    common = _find_common_spaces(agent, place.split, grid.observation) if place.split else None
    rooms = place.split.test if place.split else place.instance
    parts = 1 if isinstance(rooms, RoomInstance) else len(list_sets(rooms))
    env, recorder = make_agent_env(agent, rooms, grid.observation, order, common)
    try:
        starts = find_starts(env, recorder, seeds)
        score_range = compute_score_range(starts, agent, out / "references", parts)
        if agent.name in TRAINED_IN_ROOM and place.split is None:
            player, value = _train(run, out, env, env, None, score_range, checkpoint_seconds,
                                   make_player(agent, env, recorder))
        elif agent.is_reference:
            player: Agent = make_player(agent, env, recorder)
            if agent.name in TRAINED_IN_SET and place.split is not None:
                player.load_state_dict(_train_reference(run, place.split, common))
            evaluation = evaluate(player, env, len(seeds), run.eval_seed, grid.primitives, trials=parts)
            value = RunResult.make_reference(grid.primitives, evaluation, score_range)
        elif place.split is None:
            player, value = _train(run, out, env, env, None, score_range, checkpoint_seconds)
        else:
            player, value = _train_in_set(run, out, env, place, common, score_range, checkpoint_seconds)
        record_returns(starts, score_range.best, value.evaluations, run.source)
        if grid.trials > 1 and place.split is not None:
            value = _try_several_times(run, out, player, place.split, common, order, value)
        drawn = seeds if place.split is None else seeds[:: len(place.split.test)]  # in the pictured room
        episodes = [] if parts > 1 else [record_episode(player, env, seed).to_json() for seed in drawn]
    finally:
        env.close()
    _finish(run, out, value, episodes)


def _finish(run: GridRun, out: Path, value: RunResult, episodes: list[dict[str, Any]]) -> None:
    folder = get_run_folder(out, run)
    write_json(folder / "episodes.json", episodes, indent=None)
    write_json(folder / "run_result.json", {"identity": run.identity, "result": dataclasses.asdict(value)}, indent=None)


def _execute_in_env(run: GridRun, spec: EnvSpec, out: Path, checkpoint_seconds: float) -> RunResult:
    """Train or evaluate an agent in an environment from elsewhere, whose best return is not known."""
    agent, grid = run.agent, run.grid
    env = spec.make_agent_env(agent)
    try:
        if not agent.is_frozen:
            return _train(run, out, env, env, None, None, checkpoint_seconds)[1]
        player = make_agent(agent, env.observation_space, env.action_space, seed=0)
        return RunResult.make_reference(grid.primitives, evaluate(player, env, grid.eval_episodes, run.eval_seed,
                                                                  grid.primitives), None)
    finally:
        env.close()


def _train_reference(run: GridRun, split: Split, common: CommonSpaces | None) -> dict[str, Any]:
    """Train a reference in training rooms, and return its state."""
    from hrl_escape.agents.training.train import train

    env, recorder = make_agent_env(run.agent, split.train, run.grid.observation, common=common)
    try:
        player = make_player(run.agent, env, recorder)
        train(player, env, primitives=run.grid.primitives, seed=run.seed, eval_episodes=0, progress=False,
              observed=False)
    finally:
        env.close()
    return player.state_dict()


def _find_common_spaces(agent: AgentSpec, split: Split, observation: str) -> CommonSpaces | None:
    """Return the common spaces of training and test rooms, or None if they are equal."""
    if not split.is_transfer or (agent.is_reference and not isinstance(split.test, RoomSequence)):
        return None
    envs = [make_agent_env(agent, rooms, observation)[0] for rooms in split.sets]
    try:
        return join_spaces(envs)
    finally:
        for env in envs:
            env.close()


def _train_in_set(run: GridRun, out: Path, eval_env: gymnasium.Env, place: RunPlace, common: CommonSpaces | None,
                  score_range: ScoreRange, checkpoint_seconds: float) -> tuple[Agent, RunResult]:
    """Train in one set of rooms with evaluations in another, and evaluate in training rooms at the end."""
    assert place.split is not None
    seeds = [compute_episode_seed(run.eval_seed, "evaluation", n) for n in range(run.grid.eval_episodes)]
    order, parts = {str(seed): n for n, seed in enumerate(seeds)}, len(list_sets(place.split.train))
    env, _ = make_agent_env(run.agent, place.split.train, run.grid.observation, common=common, trials=run.grid.trials)
    again, again_recorder = make_agent_env(run.agent, place.split.train, run.grid.observation, order, common)
    try:
        agent, value = _train(run, out, env, eval_env, place.split, score_range, checkpoint_seconds)
        starts = find_starts(again, again_recorder, seeds)
        seen_range = compute_score_range(starts, run.agent, out / "references", parts)
        seen = evaluate(agent, again, len(seeds), run.eval_seed, value.primitives, value.decisions, trials=parts)
        record_returns(starts, seen_range.best, [seen], run.source)
    finally:
        env.close()
        again.close()
    return agent, dataclasses.replace(value, seen=seen, seen_range=seen_range)


def _try_several_times(run: GridRun, out: Path, player: Agent, split: Split, common: CommonSpaces | None,
                       order: Mapping[str, int], value: RunResult) -> RunResult:
    """Evaluate every trial of episodes with several trials in the test rooms."""
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


def _train(run: GridRun, out: Path, env: gymnasium.Env, eval_env: gymnasium.Env, split: Split | None,
           score_range: ScoreRange | None, checkpoint_seconds: float, player: Agent | None = None
           ) -> tuple[Agent, RunResult]:
    from hrl_escape.agents.training.train import train

    # `run.settings` and the environment hold the rest of the spec.
    chosen = OptionsView(include_primitives=run.agent.options.include_primitives)
    result = train(
        player or AgentSpec(run.agent.name, options=chosen), env, primitives=run.grid.primitives,
        decisions=run.grid.decisions, seed=run.seed, settings=None if player else run.settings, eval_env=eval_env,
        eval_every=run.grid.evaluation_step,
        eval_episodes=run.grid.eval_episodes, eval_seed=run.eval_seed, out=get_training_folder(out, run),
        checkpoint_seconds=checkpoint_seconds, progress=False,
        eval_trials=1 if split is None else len(list_sets(split.test)), observed=False,
    )
    assert result.agent is not None, "a run that this process finished or loaded has its agent"
    budget = min(run.grid.primitives, result.primitives)
    return result.agent, RunResult.make(budget, result, score_range)
