"""Training: one loop for every agent, budgets counted in primitives, runs that survive being killed.

An episode's seed is a function of the run's seed and its number, and checkpoints are taken between episodes, so no
environment needs saving: a killed run resumes to the same bits. Evaluations happen between episodes
too. It starts no processes and compares nothing; that is for `hrl_escape.experiments`.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, overload

import gymnasium
import numpy as np

from hrl_escape.agents.agent import Agent, StateTree
from hrl_escape.agents.checkpoint import load_checkpoint
from hrl_escape.agents.progress import show_progress
from hrl_escape.agents.registry import make_agent
from hrl_escape.agents.results import TrainResult
from hrl_escape.agents.run import Plan, Run, load_agent_state
from hrl_escape.agents.trials import Trials, check_batched, find_maker
from hrl_escape.errors import AgentSettingsError
from hrl_escape.files import read_json

__all__ = ["load_agent", "train"]

EnvSource = gymnasium.Env | Callable[[], gymnasium.Env]


@overload
def train(
    agent: str | Agent, env: gymnasium.Env, *, primitives: int, trials: None = None, **options: Any
) -> TrainResult: ...


@overload
def train(agent: str, env: EnvSource, *, primitives: int, trials: int, **options: Any) -> list[TrainResult]: ...


def train(  # pyright: ignore[reportInconsistentOverload]  # the other arguments are in one place only
    agent: str | Agent,
    env: EnvSource,
    *,
    primitives: int,
    decisions: int | None = None,
    seed: int = 0,
    recipe: str = "corrected",
    settings: Mapping[str, Any] | None = None,
    eval_env: EnvSource | None = None,
    eval_every: int | None = None,
    eval_episodes: int = 5,
    eval_seed: int = 0,
    out: str | os.PathLike[str] | None = None,
    checkpoint_seconds: float = 30.0,
    tensorboard: bool = False,
    progress: bool | None = None,
    trials: int | None = None,
    workers: int = 1,
) -> TrainResult | list[TrainResult]:
    """Train an agent on an environment, flat or with options.

    Args:
        agent: a name (see `registry.list_agents`, with or without `smdp-`), or an agent of your own, made new.
        env: Discrete actions; what `step` must return is in `agent.make_transition`. It must depend on nothing
            before `reset(seed=...)`, which is called for every episode.
        primitives: the budget. The decision that reaches it is the last.
        decisions: end after so many decisions too, if these are fewer; for programs that counted so.
        seed: 0 or more; fixes the agent (if named) and every training episode.
        recipe: `corrected` or `paper`, for a named agent.
        settings: fields of a named agent's settings to change.
        eval_env: where to evaluate; by default `env` itself, between episodes.
        eval_every: primitives between evaluations, a twentieth of the budget by default. Each is made at
            the first episode's end from there on, besides one before training and one after.
        eval_episodes: episodes in an evaluation; 0 leaves evaluations out.
        eval_seed: fixes evaluation episodes; leave it alone where runs are to be compared.
        out: folder for log, checkpoints and result. A run found there with the same settings goes on where its
            last checkpoint was taken, to the same bits; a finished one is returned at once.
        checkpoint_seconds: least wall time between checkpoints; 0 makes one after every episode.
        tensorboard: also write event files (needs `out` and the extra `tensorboard`).
        progress: show a progress line; by default on a terminal only.
        trials: train this many seeds at once, `seed` and those after it, with their updates made as one batch: each
            comes to what it would alone, up to the rounding of batched matrix products, whatever others there are.
            For agents that have a batched form (`trials.list_batched_agents`). Each has an environment of
            its own, made anew from the spec of `env`, or by `env` itself where that is a function without arguments.
            In `out`, the seed n has the folder `seed-n`.
        workers: processes that share the trials; one a core is fastest. They are forked.

    Returns:
        Curves, episodes, totals and the trained agent; with `trials`, one of these for each seed.

    Raises:
        AgentSettingsError: an argument or setting is impossible.
        UnknownNameError: no such agent, recipe or setting.
        StepContractError: the environment breaks the contract.
        DivergenceError: a loss became NaN; names run and primitive.
        RunMismatchError, RunBusyError, CheckpointError, FileWriteError: about `out`.
        WorkerLostError: a process of `workers` is gone.
    """
    eval_every = eval_every or max(1, primitives // 20)
    for name, value, least in (
        ("primitives", primitives, 1),
        ("decisions", 1 if decisions is None else decisions, 1),
        ("eval_every", eval_every, 1),
        ("eval_episodes", eval_episodes, 0),
        ("eval_seed", eval_seed, 0),
        ("seed", seed, 0),
        ("trials", 1 if trials is None else trials, 1),
        ("workers", workers, 1),
    ):
        if not isinstance(value, (int, np.integer)) or value < least:
            raise AgentSettingsError(name, value, f"it must be a whole number, {least} or more")
    if settings is not None and not isinstance(settings, Mapping):
        raise AgentSettingsError("settings", settings, "it must map names of settings to values, or be None")
    if tensorboard and out is None:
        raise AgentSettingsError("tensorboard", True, "event files need a folder: give out=")
    name = agent if isinstance(agent, str) else type(agent).__name__

    def make_learner(one: int, within: gymnasium.Env) -> Agent:
        if isinstance(agent, str):
            return make_agent(agent, within.observation_space, within.action_space, one, recipe, **settings or {})
        return agent

    def make_run(one: int, within: Any, evaluated_in: Any, folder: str | os.PathLike[str] | None) -> Run:
        plan = Plan(name, one, primitives, decisions, eval_every, eval_episodes, eval_seed)
        run = Run(make_learner(one, within), within, evaluated_in or within, plan, hands_out=trials is not None)
        if folder is not None:
            run.open(folder, tensorboard)
        return run

    if trials is not None:
        check_batched(agent, trials)
        make_env, make_eval_env = find_maker("env", env), find_maker("eval_env", eval_env) if eval_env else None

        def start(one: int) -> Run:
            folder = None if out is None else Path(out) / f"seed-{one}"
            return make_run(one, make_env(), make_eval_env() if make_eval_env else None, folder)

        def revive(one: int, state: StateTree) -> Agent:
            learner = make_learner(one, env if isinstance(env, gymnasium.Env) else make_env())
            learner.load_state_dict(state)
            return learner

        seeds = range(seed, seed + trials)
        return Trials(name, seeds, start, revive, primitives, checkpoint_seconds).train(workers, progress)

    run = make_run(seed, env, eval_env, out)
    try:
        with show_progress(f"{name} seed {seed}", primitives, run.primitives, progress) as report:
            return run.finish(checkpoint_seconds, report)
    finally:
        run.close()


def load_agent(folder: str | os.PathLike[str], env: gymnasium.Env) -> Agent:
    """The agent of a run as of its last checkpoint; in a finished run, the trained one.

    Args:
        folder: the run's, of a named agent.
        env: gives the spaces; the same environment as in training.

    Raises:
        FileReadError: no checkpoint or description there.
        CheckpointError: the checkpoint is damaged or does not fit.
    """
    described = read_json(Path(folder) / "run.json", "description of a run")
    state = load_checkpoint(Path(folder) / "checkpoint.npz")
    agent = make_agent(
        described["name"], env.observation_space, env.action_space, described["seed"], **described["settings"]
    )
    load_agent_state(agent, state, str(folder))
    return agent
