"""Options with a learned policy: of an agent of this package, a Stable-Baselines3 model, or any function.

`LearnedOption` makes an option of one policy and a termination. `make_learned_options` makes options of everything that
an agent returns by `get_options`: tasks of a hierarchy, policies to subgoals, macros, or its whole policy. This module
imports neither agents nor Stable-Baselines3 and uses protocols instead.
"""

from __future__ import annotations

import copy
import numbers
from collections.abc import Callable, Mapping
from typing import Any, Protocol, TypeAlias, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from hrl_escape.errors import OptionError
from hrl_escape.options.option import FunctionOption, Option
from hrl_escape.planning.route import PlanningReport

LegalActions: TypeAlias = int | Callable[[Any], NDArray[np.bool_]]
"""Number of actions, all legal, or a function from the state to the legal actions, bool (actions,)."""


@runtime_checkable
class TrainedAgent(Protocol):
    """Agent that acts for evaluation, such as the agents of `hrl_escape.agents`."""

    def act_greedy(self, observation: Any, action_mask: NDArray[np.bool_], rng: np.random.Generator) -> int:
        """Choose an action without learning. A stochastic policy draws from `rng`."""
        ...


@runtime_checkable
class PredictingModel(Protocol):
    """Stable-Baselines3 model, or any object with its `predict`."""

    def predict(self, observation: Any, *, deterministic: bool = False) -> tuple[Any, Any]:
        """Return the action and the state of the policy."""
        ...


def _find_legal(legal: LegalActions, state: Any) -> NDArray[np.bool_]:
    return np.asarray(legal(state), np.bool_) if callable(legal) else np.ones(legal, np.bool_)


def _check_legal(name: str, legal: LegalActions, state: Any, count: int) -> None:
    """Check that there is an entry for every action of the environment. Raises `OptionError`."""
    shape = _find_legal(legal, state).shape
    if shape != (count,):
        said = f"its legal gives an array of shape {shape}" if callable(legal) else f"its legal is {legal}"
        raise OptionError(f"option {name!r} acts in an environment of {count} actions, and {said}: give that number, "
                          "or a function of the state that gives a bool for each")


class LearnedOption(FunctionOption):
    """Option with a learned policy.

    Args:
        name: stable name.
        policy: a trained agent from `train` or `load_agent`; a Stable-Baselines3 model; or a function observation ->
            primitive, with a generator as its second argument if it is stochastic.
        termination: state -> probability of ending there.
        observe: state -> the observation that the policy was trained on, such as `make_observer("features",
            rules).observe` in a room, or None for the state itself.
        initiation: state -> whether the option can start there, or None for everywhere.
        is_stochastic: whether the policy draws from the caller's generator. For an agent, `act_greedy` receives it.
        legal: for an agent, the number of its actions, or state -> legal actions, bool (actions,).

    Raises:
        OptionError: the policy is none of these, an agent has no `legal`, or a model is marked as stochastic.
    """

    def __init__(self, name: str, policy: Callable[..., Any] | TrainedAgent | PredictingModel,
                 termination: Callable[[Any], float], observe: Callable[[Any], Any] | None = None,
                 initiation: Callable[[Any], bool] | None = None, is_stochastic: bool = False,
                 legal: LegalActions | None = None) -> None:
        if isinstance(policy, PredictingModel) and is_stochastic:
            raise OptionError(f"option {name!r}: predict draws from torch's global generator, so runs could not be "
                              "repeated: leave is_stochastic false, or give a function of observation and generator")
        if isinstance(policy, TrainedAgent) and legal is None:
            raise OptionError(f"option {name!r} follows an agent, which needs the legal actions: give legal=, the "
                              "number of its actions or a function of the state")
        if not (callable(policy) or isinstance(policy, (TrainedAgent, PredictingModel))):
            raise OptionError(f"option {name!r} has the policy {policy!r}: give a function, an agent with act_greedy, "
                              "or a model with predict")
        super().__init__(name, _LearnedPolicy(policy, observe, legal, is_stochastic), termination, initiation,
                         is_stochastic)
        self._legal = legal

    def check_actions(self, state: Any, count: int) -> None:
        """Check that `legal` has one entry for each action of the environment.

        Raises:
            OptionError: it has more or fewer.
        """
        if self._legal is not None:
            _check_legal(self.name, self._legal, state, count)


class _LearnedPolicy:
    """Policy of a `LearnedOption`, which copies of the option share."""

    def __init__(self, learned: Any, observe: Callable[[Any], Any] | None, legal: LegalActions | None,
                 is_stochastic: bool) -> None:
        self.learned, self.observe, self.legal = learned, observe, legal
        self._is_stochastic = is_stochastic

    def __call__(self, state: Any, rng: np.random.Generator | None = None) -> Any:
        observation = state if self.observe is None else self.observe(state)
        if isinstance(self.learned, TrainedAgent):
            assert self.legal is not None
            return self.learned.act_greedy(observation, _find_legal(self.legal, state), rng or np.random.default_rng(0))
        if isinstance(self.learned, PredictingModel):
            return self.learned.predict(observation, deterministic=True)[0]
        return self.learned(observation, rng) if self._is_stochastic else self.learned(observation)

    def __deepcopy__(self, memo: dict[int, Any]) -> _LearnedPolicy:
        return self

    def describe(self) -> Mapping[str, Any]:
        """Return the learned part and its settings, which identify a run; for a model, its network."""
        network = getattr(self.learned, "policy", None) if isinstance(self.learned, PredictingModel) else None
        return {"learned": self.learned if network is None else network, "observe": self.observe, "legal": self.legal,
                "is_stochastic": self._is_stochastic}


class AgentOption(Option):
    """Option that follows a policy of a trained agent.

    Args:
        learned: the policy, from the agent's `get_options`: a `hrl_escape.agents.agent.OptionPolicy`.
        legal: number of the agent's actions, or state -> legal actions, bool (actions,).
        observe: state -> the observation of the agent, or None for the state itself.
        until: state -> probability of ending there, in addition to the policy's own termination, or None for the latter
            alone.
        name: stable name, or None for the policy's.

    Attributes:
        origin: run that learned it: `agent`, `run`, `seed`, `primitives`; empty for an untrained agent.
    """

    def __init__(self, learned: Any, legal: LegalActions, observe: Callable[[Any], Any] | None = None,
                 until: Callable[[Any], float] | None = None, name: str | None = None) -> None:
        super().__init__(learned.name if name is None else name)
        self.is_markov, self.origin = learned.is_markov, dict(learned.origin)
        self._learned, self._legal, self._observe, self._until = learned, legal, observe, until
        self._run: Any = None

    def _look(self, state: Any) -> tuple[Any, NDArray[np.bool_]]:
        return state if self._observe is None else self._observe(state), _find_legal(self._legal, state)

    def _get_run(self) -> Any:
        """Return the present run. A policy that is a function of the state can use any run."""
        if self._run is None or self.is_markov:
            self._run = self._learned.begin()
        return self._run

    def check_actions(self, state: Any, count: int) -> None:
        """Check that `legal` has one entry for each action of the environment. Raises `OptionError`."""
        _check_legal(self.name, self._legal, state, count)

    def initiation(self, state: Any) -> bool:
        """Return whether the policy can start here; false where `until` is certain to end it."""
        return bool(self._learned.can_start(*self._look(state))) and (self._until is None or self._until(state) < 1.0)

    def start(self, state: Any) -> None:
        """Start a run of the policy."""
        super().start(state)
        self._run = self._learned.begin()

    def policy(self, state: Any) -> Any:
        """Return the action of the policy. Raises `OptionError` if the policy has a memory or is random."""
        if not self.is_markov:
            raise OptionError(f"option {self.name!r} is not a function of the state: call sample_action(state, "
                              "generator)")
        return self.sample_action(state, np.random.default_rng(0))

    def sample_action(self, state: Any, rng: np.random.Generator) -> Any:
        """Sample from the policy with this generator."""
        return self._get_run().act(*self._look(state), rng)

    def termination(self, state: Any) -> float:
        """Return the probability that the policy or `until` ends here."""
        own = float(self._get_run().compute_termination(*self._look(state)))
        return own if self._until is None else 1.0 - (1.0 - own) * (1.0 - float(self._until(state)))

    def __deepcopy__(self, memo: dict[int, Any]) -> AgentOption:
        """Copy the option without a run, sharing its policy: environments copy their arguments."""
        copied = copy.copy(self)
        copied._run, copied.report = None, PlanningReport()
        return copied

    def describe(self) -> Mapping[str, Any]:
        """Return agent and arguments, which identify a run over this option, and `origin` unhashed."""
        return {"policy": self._learned.name, "learned": self._learned.agent, "observe": self._observe,
                "legal": self._legal, "until": self._until, "origin": self.origin}


def make_learned_options(agent: Any, legal: LegalActions, *, observe: Callable[[Any], Any] | None = None,
                         until: Callable[[Any], float] | None = None, prefix: str = "") -> tuple[AgentOption, ...]:
    """Make options of all policies that an agent has learned.

    For a hierarchical agent, these are its tasks, goals, orders, machines or macros, each with its own termination. For
    any other agent it is its greedy policy, named `policy`, which ends where `until` says. An option uses the present
    parameters of the agent: copy the agent before you train it further.

    Args:
        agent: a trained agent from `train` or `load_agent`.
        legal: number of its actions, or state -> legal actions, bool (actions,).
        observe: state -> the observation it was trained on, or None for the state itself. In a room use
            `make_observer("features", rules).observe` and the like, for a synthesised hierarchy `HierarchyEnv.observe`.
        until: state -> probability of ending there, for all options, in addition to their own terminations.
        prefix: prefix of every name, to distinguish the options of several agents.

    Raises:
        OptionError: the agent has no policies to return, or `legal` is neither a number nor a function.
    """
    if not hasattr(agent, "get_options"):
        raise OptionError(f"{agent!r} has no get_options: give a trained agent, as train and load_agent return it")
    if not callable(legal) and (isinstance(legal, bool) or not isinstance(legal, numbers.Integral) or legal < 1):
        raise OptionError(f"legal is {legal!r}: give the number of the agent's actions, or a function of the state "
                          "that gives a bool for each")
    given = agent.get_options()
    if not given:
        raise OptionError(f"{type(agent).__name__} has no learned policies: train it first")
    return tuple(AgentOption(each, legal, observe, until, prefix + each.name) for each in given)
