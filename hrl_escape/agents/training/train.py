"""Training: one loop for every agent, budgets in primitives, runs that resume to the same bits.

An episode's seed is a function of the run's seed and its number, and checkpoints are taken between episodes, so no
environment needs saving: a killed run resumes to the same bits. Evaluations happen between episodes
too. `hrl_escape.benchmark` runs many of them.
"""

from __future__ import annotations

import dataclasses
import os
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
from gymnasium.vector import VectorEnv, VectorRewardWrapper, VectorWrapper

from hrl_escape.agents.agent import Agent
from hrl_escape.agents.making import make_agent, read_structure
from hrl_escape.agents.many_envs import ManyEnvs
from hrl_escape.agents.registry import get_agent_class, list_many_env_agents
from hrl_escape.agents.single_env import MANY
from hrl_escape.agents.spec import AgentSpec
from hrl_escape.agents.training.callbacks import Callback
from hrl_escape.agents.training.checkpoint import compute_state_digest, load_checkpoint
from hrl_escape.agents.training.env_description import (
    check_spec,
    compute_digest,
    hash_large_parts,
    load_part,
    make_described_env,
)
from hrl_escape.agents.training.evaluation import compute_episode_seed
from hrl_escape.agents.training.results import TrainResult
from hrl_escape.agents.training.run import (
    Probe,
    Run,
    RunArguments,
    load_agent_state,
    make_origin,
    refusing_damage,
)
from hrl_escape.agents.training.run_folder import BEST, LAST, read_run
from hrl_escape.errors import AgentSettingsError, CheckpointError, TrustError, UnknownNameError, describe_damage
from hrl_escape.progress import show_progress
from hrl_escape.registry import Registry
from hrl_escape.settings import replace_settings

if TYPE_CHECKING:
    from hrl_escape.agents.components.offline import OfflineData

run_observers: Registry[Callable[..., object]] = Registry(
    "run observer", "a function (env, seeds, evaluations, source)", callable,
    {"best-known-returns": "hrl_escape.benchmark.records:record_escapes"})
"""Functions that `train` calls at its end, as `observer(env, seeds, evaluations, source)`: the evaluation environment,
the seeds of an evaluation's episodes, the evaluations, and agent and seed in words. They are imported when a run has
ended."""


def train(
    agent: str | AgentSpec | type[Agent] | Agent,
    env: gymnasium.Env | VectorEnv | ManyEnvs | None = None,
    *,
    primitives: int | None = None,
    data: str | os.PathLike[str] | OfflineData | None = None,
    decisions: int | None = None,
    seed: int = 0,
    settings: Mapping[str, Any] | None = None,
    eval_env: gymnasium.Env | None = None,
    eval_every: int | None = None,
    eval_episodes: int = 5,
    eval_seed: int = 0,
    out: str | os.PathLike[str] | None = None,
    checkpoint_seconds: float = 30.0,
    callbacks: Sequence[Callback] = (),
    progress: bool | None = None,
    probe: Probe | None = None,
    threads: int = 1,
    until_return: float | None = None,
    eval_trials: int = 1,
    observed: bool = True,
) -> TrainResult:
    """Train an agent on an environment, flat or with options, or from a data set.

    Args:
        agent: a spec such as `dqn`, `smdp-dqn` or `smdp-ppo+objects+memory` (see `agents.spec`), a class, or an agent
            instance without training. The options, memory and hierarchy of a spec must be the environment's.
        env: Discrete or Box actions, as the agent supports; `agent.make_transition` documents the contract of `step`.
            It must not depend on state from before `reset(seed=...)`, which is called for every episode. An environment
            of your own must keep its arguments under their names, or have a `describe` method (see `DescribedEnv`), so
            that runs with other arguments have another identity. A vector environment, or a `BatchedOptionsEnv`, trains
            agents that learn from many environments (see `list_many_env_agents`) on its device; returns are then logged
            by segments of steps instead of episodes. With `data` it is the evaluation environment, by default the data
            set's.
        primitives: budget, of all environments together. The decision that reaches it is the last. With `data` the
            primitives learned from, counted at each pass; by default as many as the agent's `passes` say.
        data: data set, by name, by the path of a recording, or from `hrl_escape.data.load_data`, for agents that learn
            offline. Agents over options, such as `smdp-iql`, learn from decisions, others from primitives.
        decisions: budget of decisions, if it is spent earlier; for programs that counted decisions.
        seed: 0 or more; fixes the agent (if named) and every training episode.
        settings: fields of the agent's settings to change, if `agent` is a spec or class; they come after the spec's.
        eval_env: evaluation environment; by default `env` itself, between episodes, or one of many.
        eval_every: primitives between evaluations, a twentieth of the budget by default. Each is made at
            the next end of an episode, in addition to one before training and one after.
        eval_episodes: episodes in an evaluation; 0 turns evaluations off.
        eval_seed: fixes the evaluation episodes; use one value for all runs that are compared.
        out: folder for log, checkpoints and result; `{key}` in its name becomes a hash of everything that decides
            the run's numbers. The same run found there continues from its last checkpoint, to the same bits; a
            finished one is returned at once; any other run is refused. Ctrl-C, SIGTERM and SIGHUP save the run
            at the end of the episode that is running. The agent of the best evaluation is kept as well as the last.
        checkpoint_seconds: least wall time between checkpoints; 0 makes one after every episode.
        callbacks: observers of rows, evaluations and checkpoints, such as `TensorBoard()`; see
            `agents.training.callbacks`.
        progress: False for no progress line. By default a bar with rate, return, success and time left in terminals and
            notebooks, and a line a minute elsewhere; see `show_progress`.
        probe: measures the agent during training, and can end the run before its budget.
        threads: of torch while the run lasts, a part of what decides its numbers. One is quickest for small networks;
            many environments at once on a CPU are quicker with one per core.
        until_return: end before the budget, after two evaluations in a row whose mean return is at least this, or None
            to train for all of it.
        eval_trials: parts of an evaluation episode that count as episodes of their own; see `evaluate`.
        observed: call `run_observers` at the end. This package's raises the best known return of a room, with a
            warning, where an evaluation has beaten it. Not called where `eval_trials` is above 1.

    Returns:
        Curves, episodes, totals and the trained agent.

    Raises:
        AgentSettingsError: an argument or setting is impossible, or the spec disagrees with the environment.
        UnknownNameError: no such agent, part, named settings or setting.
        StepContractError: the environment breaks the contract.
        DivergenceError: a loss became NaN; names run and primitive.
        RunMismatchError, RunBusyError, CheckpointError, FileWriteError: about `out`.
    """
    if settings is not None and not isinstance(settings, Mapping):
        raise AgentSettingsError("settings", settings, "a mapping from names of settings to values, or None")
    if isinstance(agent, str):
        agent = AgentSpec.parse(agent)
    material = None
    if data is not None:
        from hrl_escape.agents.training.offline_run import OfflineRun, gather_material  # brings torch in

        material = gather_material(agent, env, data, settings)
        env, primitives = material.env, material.budget if primitives is None else primitives
    if env is None or primitives is None:
        raise AgentSettingsError("env" if env is None else "primitives", None, "given, unless there is data=")
    if isinstance(env, str):
        raise AgentSettingsError("env", env, f"an environment, such as gymnasium.make({env!r})")
    eval_every = max(1, primitives // 20) if eval_every is None else eval_every
    arguments = RunArguments(agent.name, seed, primitives, decisions, eval_every, eval_episodes, eval_seed,
                             threads=threads, until_return=until_return, eval_trials=eval_trials)
    _check_arguments(arguments, callbacks)
    if isinstance(agent, AgentSpec):
        get_agent_class(agent.name)  # loads torch where it is needed, before its threads are set
    with _using_threads(threads):
        single = env if isinstance(env, gymnasium.Env) else (eval_env or make_single_env(env))
        if isinstance(agent, AgentSpec):
            check_spec(agent, single)
        if isinstance(agent, Agent):
            learner = agent
            if out is not None:
                arguments = dataclasses.replace(arguments, agent_state=compute_state_digest(learner.state_dict()))
        else:
            learner = make_agent(agent, single.observation_space, single.action_space, seed, read_structure(single),
                                 **settings or {})
        if probe is not None and not (material is None and isinstance(env, gymnasium.Env)):
            raise AgentSettingsError("probe", probe, "None with many environments or a data set")
        if material is not None:
            run = OfflineRun(learner, arguments, material, callbacks)  # pyright: ignore[reportPossiblyUnboundVariable]
        elif isinstance(env, gymnasium.Env):
            run = Run(learner, env, eval_env or env, arguments, probe, callbacks)
        else:
            run = _make_many_envs_run(learner, env, single, arguments, callbacks)
        if out is not None:
            run.open(os.fspath(out).replace("{key}", run.key))
        try:
            with show_progress(f"{agent.name} seed {seed}", primitives, run.primitives, progress) as report:
                result = run.finish(checkpoint_seconds, report)
        finally:
            run.close()
        if observed and result.evaluations and eval_trials == 1:
            seeds = [compute_episode_seed(eval_seed, "evaluation", n) for n in range(eval_episodes)]
            for observer in run_observers.load_all().values():
                observer(eval_env or single, seeds, result.evaluations, f"{agent.name}, seed {seed}")
        return result


def _check_arguments(arguments: RunArguments, callbacks: Sequence[Callback]) -> None:
    for name, least in {"primitives": 1, "decisions": 1, "eval_every": 1, "eval_episodes": 0, "eval_seed": 0,
                        "seed": 0, "threads": 1, "eval_trials": 1}.items():
        value = getattr(arguments, name)
        if name == "decisions" and value is None:
            continue
        if not isinstance(value, (int, np.integer)) or value < least:
            raise AgentSettingsError(name, value, f"a whole number of at least {least}")
    until_return = arguments.until_return
    if until_return is not None and (not isinstance(until_return, (int, float)) or not arguments.eval_episodes):
        raise AgentSettingsError("until_return", until_return, "a mean return, with eval_episodes above 0, or None")
    for callback in callbacks:
        if not isinstance(callback, Callback):
            raise AgentSettingsError("callbacks", callback, "objects derived from hrl_escape.agents.Callback")


def _make_many_envs_run(learner: Agent, env: VectorEnv | ManyEnvs, single: gymnasium.Env, arguments: RunArguments,
                        callbacks: Sequence[Callback]) -> Run:
    if not isinstance(learner, MANY):
        raise AgentSettingsError("agent", arguments.name, "one that learns from many environments at once: "
                                 f"{', '.join(list_many_env_agents())}; or give train an ordinary environment")
    from hrl_escape.agents.training.many_envs import ManyEnvsRun  # brings torch in

    return ManyEnvsRun(learner, env, single, arguments, callbacks)


@contextmanager
def _using_threads(threads: int) -> Iterator[None]:
    """Set the number of torch's threads, and restore it afterwards, if torch is loaded.

    Sums over several threads differ in the last bit, so their number is part of a run.
    """
    torch = sys.modules.get("torch")
    if torch is None:
        yield
        return
    before = torch.get_num_threads()
    torch.set_num_threads(threads)
    try:
        yield
    finally:
        torch.set_num_threads(before)


_SAME_TASK = ("NormalizeReward", "RecordEpisodeStatistics", "RecordVideo", "HumanRendering", "ArrayConversion",
              "JaxToNumpy", "JaxToTorch", "NumpyToTorch")
"""Wrappers of Gymnasium, besides wrappers of rewards, that do not change what an agent sees and does."""


def make_single_env(env: VectorEnv | ManyEnvs) -> gymnasium.Env:
    """Make an ordinary environment of the same task as many at once, for their evaluations.

    Raises:
        AgentSettingsError: it cannot be made; give one.
    """
    inner: Any = env
    while isinstance(inner, VectorWrapper) and not hasattr(inner, "make_single_env"):
        kind = type(inner)
        is_harmless = kind.__module__.startswith("gymnasium.") and kind.__name__ in _SAME_TASK
        if not is_harmless and not isinstance(inner, VectorRewardWrapper):
            raise AgentSettingsError("eval_env", None, f"an ordinary environment with the effect of {kind.__name__}: "
                                     "the vector environment has this wrapper, and the environment made for "
                                     "evaluation would lack it")
        inner = inner.env
    if hasattr(inner, "make_single_env"):
        maker: Any = inner
        return maker.make_single_env()
    spec = getattr(inner, "spec", None)
    if spec is None:
        raise AgentSettingsError("eval_env", None, "an ordinary environment of the same task: this vector environment "
                                 "was not made by gymnasium.make_vec")
    made_by_vector = ("num_envs", "vectorization_mode", "vector_kwargs", "wrappers")
    return gymnasium.make(spec.id, **{name: value for name, value in spec.kwargs.items() if name not in made_by_vector})


def load_agent(folder: str | os.PathLike[str], env: gymnasium.Env | None = None, *, best: bool = False,
               trust: bool = False) -> Agent:
    """Load the agent of a run as of its last checkpoint; in a finished run, the trained one.

    Args:
        folder: folder of a run.
        env: environment with the spaces of the training; by default the run's own, see `load_env`.
        best: load the agent of the evaluation with the highest mean return so far, the first of equals.
        trust: let the run's agent and environment import any code that the folder names; use it only for folders of
            your own.

    Raises:
        FileReadError: no checkpoint or description there.
        TrustError: the run's agent or environment needs code from elsewhere; the message names it.
        CheckpointError: the description or the checkpoint is damaged or does not fit, or the agent's class is not made
            from spaces, seed and settings.
    """
    described = read_run(folder)
    state = load_checkpoint(Path(folder) / (BEST if best else LAST))
    if state.get("key") != compute_digest(hash_large_parts(described)):
        raise CheckpointError(f"{folder}: the checkpoint belongs to another run than run.json in its folder")
    own = load_env(folder, trust=trust) if env is None else None
    spaces = env or own
    assert spaces is not None
    try:
        agent = _make_described_agent(described, spaces, trust, str(folder))
    finally:
        if own is not None:
            own.close()
    load_agent_state(agent, state, str(folder))
    with refusing_damage(f"{folder}: the checkpoint"):
        agent.origin = make_origin(described["name"], state["key"], described["seed"], int(state["primitives"]))
    return agent


def _make_described_agent(described: Mapping[str, Any], env: gymnasium.Env, trust: bool, where: str) -> Agent:
    """Make the untrained agent of a run, by its name or by the class in the run's description."""
    try:
        get_agent_class(described.get("name", ""))
    except UnknownNameError as error:
        if not isinstance(path := described.get("agent"), str):
            raise CheckpointError(f"{where}: the description of this run names no agent") from error
        try:
            made = load_part(path, trust)
            settings = replace_settings(made.Settings(), described["settings"])
            return made(env.observation_space, env.action_space, described["seed"], settings)
        except TrustError:
            raise
        except Exception as reason:
            raise CheckpointError(f"{where}: its agent is not made by {path}(observation_space, action_space, seed, "
                                  f"settings) ({describe_damage(reason)})") from reason
    with refusing_damage(f"{where}: the description of this run"):
        return make_agent(described["name"], env.observation_space, env.action_space, described["seed"],
                          structure=read_structure(env), **described["settings"])


def load_env(folder: str | os.PathLike[str], *, trust: bool = False) -> gymnasium.Env:
    """Make the environment of a run again: room, observation, options and wrappers.

    Args:
        folder: folder of the run.
        trust: import any code that the folder names; use it only for folders of your own.

    Raises:
        FileReadError: no description there.
        TrustError: it names code from elsewhere; the message names it.
        CheckpointError: it is damaged, or the environment has arguments that no file keeps.
    """
    return make_described_env(read_run(folder).get("environment", {}), trust=trust)
