"""Options whose policy was learned: by an agent of this package, by Stable-Baselines3, or by any function.

`LearnedOption` makes an option of one policy and a termination. `make_learned_options` makes one of everything that an
agent teaches by `get_options`: the tasks of a hierarchy, the ways to subgoals, macros, or its whole policy. No agent or
Stable-Baselines3 is imported here: protocols state what they must offer.
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
"""Number of actions, all legal, or a function of the state that gives a bool (actions,) of the legal ones."""


@runtime_checkable
class TrainedAgent(Protocol):
    """Agent that acts for evaluation; those of `hrl_escape.agents` do."""

    def act_greedy(self, observation: Any, action_mask: NDArray[np.bool_], rng: np.random.Generator) -> int:
        """Choose without learning; a policy that is random by nature draws from `rng`."""
        ...


@runtime_checkable
class PredictingModel(Protocol):
    """Model of Stable-Baselines3, or any other with its `predict`."""

    def predict(self, observation: Any, *, deterministic: bool = False) -> tuple[Any, Any]:
        """Return the action and the policy's memory."""
        ...


def _find_legal(legal: LegalActions, state: Any) -> NDArray[np.bool_]:
    """Legal actions, bool (actions,)."""
    return np.asarray(legal(state), np.bool_) if callable(legal) else np.ones(legal, np.bool_)


def _check_legal(name: str, legal: LegalActions, state: Any, count: int) -> None:
    """Require an entry for every action of the environment. Raises `OptionError`."""
    shape = _find_legal(legal, state).shape
    if shape != (count,):
        said = f"its legal gives an array of shape {shape}" if callable(legal) else f"its legal is {legal}"
        raise OptionError(f"option {name!r} acts in an environment of {count} actions, and {said}: give that number, "
                          "or a function of the state that gives a bool for each")


class LearnedOption(FunctionOption):
    """Option whose policy was learned.

    Args:
        name: stable name.
        policy: a trained agent, as `train` and `load_agent` return it; a Stable-Baselines3 model; or a function
            observation -> primitive, with a generator as its second argument if it is stochastic.
        termination: state -> probability of ending there.
        observe: state -> the observation that the policy was trained on, such as
            `make_observer("features", rules).observe` in a room; None for the state itself.
        initiation: state -> whether it may start there; None for anywhere.
        is_stochastic: the policy draws, from the caller's generator: of an agent, what `act_greedy` leaves to chance.
        legal: for an agent, the number of its actions, or state -> bool (actions,) of the legal ones.

    Raises:
        OptionError: the policy is none of these, an agent comes without `legal`, or a stochastic model is asked for.
    """

    def __init__(self, name: str, policy: Callable[..., Any] | TrainedAgent | PredictingModel,
                 termination: Callable[[Any], float], observe: Callable[[Any], Any] | None = None,
                 initiation: Callable[[Any], bool] | None = None, is_stochastic: bool = False,
                 legal: LegalActions | None = None) -> None:
        if isinstance(policy, PredictingModel) and is_stochastic:
            raise OptionError(f"option {name!r}: predict draws from torch's global generator, so that no run could be "
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
        """Refuse an environment unless `legal` has one entry for each of its actions.

        Raises:
            OptionError: it has more or fewer.
        """
        if self._legal is not None:
            _check_legal(self.name, self._legal, state, count)


class _LearnedPolicy:
    """Policy of a `LearnedOption`; copies of the option share what was learned."""

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
        """Learned part and its settings, for the identity of a run; of a model, its network."""
        network = getattr(self.learned, "policy", None) if isinstance(self.learned, PredictingModel) else None
        return {"learned": self.learned if network is None else network, "observe": self.observe, "legal": self.legal,
                "is_stochastic": self._is_stochastic}


class AgentOption(Option):
    """Option that follows a policy of a trained agent.

    Args:
        learned: the policy, as an agent's `get_options` gives it: `hrl_escape.agents.agent.OptionPolicy`.
        legal: number of the agent's actions, or state -> bool (actions,) of the legal ones.
        observe: state -> observation that the agent knows; None for the state itself.
        until: state -> probability of ending there, in addition to the policy's own end; None for that alone.
        name: None for the policy's.

    Attributes:
        origin: run in which it was learned: `agent`, `run`, `seed`, `primitives`; empty for an agent never trained.
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
        """Return the present run; a policy that is a function of the state can use any run."""
        if self._run is None or self.is_markov:
            self._run = self._learned.begin()
        return self._run

    def check_actions(self, state: Any, count: int) -> None:
        """Refuse an environment unless `legal` has one entry for each of its actions. Raises `OptionError`."""
        _check_legal(self.name, self._legal, state, count)

    def initiation(self, state: Any) -> bool:
        """Ask the policy; false where `until` is certain to end it."""
        return bool(self._learned.can_start(*self._look(state))) and (self._until is None or self._until(state) < 1.0)

    def start(self, state: Any) -> None:
        """Begin a run of the policy."""
        super().start(state)
        self._run = self._learned.begin()

    def policy(self, state: Any) -> Any:
        """Ask the policy. Raises `OptionError` where it remembers or draws: only `sample_action` then chooses."""
        if not self.is_markov:
            raise OptionError(f"option {self.name!r} is no function of the state: ask sample_action(state, generator)")
        return self.sample_action(state, np.random.default_rng(0))

    def sample_action(self, state: Any, rng: np.random.Generator) -> Any:
        """Ask the policy, which draws from this generator what it leaves to chance."""
        return self._get_run().act(*self._look(state), rng)

    def termination(self, state: Any) -> float:
        """Probability that the policy ends here by itself, or that `until` ends it."""
        own = float(self._get_run().compute_termination(*self._look(state)))
        return own if self._until is None else 1.0 - (1.0 - own) * (1.0 - float(self._until(state)))

    def __deepcopy__(self, memo: dict[int, Any]) -> AgentOption:
        """A copy without a run, of the same policy: environments copy their arguments."""
        copied = copy.copy(self)
        copied._run, copied.report = None, PlanningReport()
        return copied

    def describe(self) -> Mapping[str, Any]:
        """Agent, and the way it is asked, by which a run over this option is recognised; `origin` is kept in clear."""
        return {"policy": self._learned.name, "learned": self._learned.agent, "observe": self._observe,
                "legal": self._legal, "until": self._until, "origin": self.origin}


def make_learned_options(agent: Any, legal: LegalActions, *, observe: Callable[[Any], Any] | None = None,
                         until: Callable[[Any], float] | None = None, prefix: str = "") -> tuple[AgentOption, ...]:
    """Make options of all policies that an agent has learned.

    Of a hierarchical agent these are its tasks, goals, orders, machines or macros, each until it is over; of any other
    agent its greedy policy, under the name `policy`, which ends where `until` says so and nowhere else. An option uses
    the agent's present knowledge: copy the agent before you train it further.

    Args:
        agent: a trained agent, as `train` and `load_agent` return it.
        legal: number of its actions, or state -> bool (actions,) of the legal ones.
        observe: state -> the observation it was trained on; None for the state itself. In a room that is
            `make_observer("features", rules).observe` and the like, for a synthesised hierarchy `HierarchyEnv.observe`.
        until: state -> probability of ending there, for all its options, in addition to their own ends.
        prefix: put before every name, to tell the options of several agents apart.

    Raises:
        OptionError: it is no such agent, has no policies to give, or `legal` is neither a number nor a function.
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
