"""Options whose policy was learned: by an agent of this package, by Stable-Baselines3, or by any function.

No agent or Stable-Baselines3 is imported here: two protocols state what a policy must offer.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Protocol, TypeAlias, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from hrl_escape.errors import OptionError
from hrl_escape.options.option import FunctionOption

__all__ = ["LearnedOption", "LegalActions", "PredictingModel", "TrainedAgent", "check_legal", "find_legal"]

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


def find_legal(legal: LegalActions, state: Any) -> NDArray[np.bool_]:
    """Legal actions, bool (actions,)."""
    return np.asarray(legal(state), np.bool_) if callable(legal) else np.ones(legal, np.bool_)


def check_legal(name: str, legal: LegalActions, state: Any, count: int) -> None:
    """Require an entry for every action of the environment.

    Raises:
        OptionError: there are more or fewer.
    """
    shape = find_legal(legal, state).shape
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
            `make_observer(instance, "features")` in a room; None for the state itself.
        initiation: state -> whether it may start there; None for anywhere.
        is_stochastic: the policy draws, from the caller's generator: of an agent, what `act_greedy` leaves to chance.
        legal: for an agent, the number of its actions, or state -> bool (actions,) of the legal ones.

    Raises:
        OptionError: the policy is none of these, an agent comes without `legal`, or a stochastic model is asked for.
    """

    def __init__(
        self,
        name: str,
        policy: Callable[..., Any] | TrainedAgent | PredictingModel,
        termination: Callable[[Any], float],
        observe: Callable[[Any], Any] | None = None,
        initiation: Callable[[Any], bool] | None = None,
        is_stochastic: bool = False,
        legal: LegalActions | None = None,
    ) -> None:
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
            check_legal(self.name, self._legal, state, count)


class _LearnedPolicy:
    """Policy of a `LearnedOption` as a function of the state; copies of the option share what was learned."""

    def __init__(self, learned: Any, observe: Callable[[Any], Any] | None, legal: LegalActions | None,
                 is_stochastic: bool) -> None:
        self.learned, self.observe, self.legal = learned, observe, legal
        self._is_stochastic = is_stochastic

    def __call__(self, state: Any, rng: np.random.Generator | None = None) -> Any:
        observation = state if self.observe is None else self.observe(state)
        if isinstance(self.learned, TrainedAgent):
            assert self.legal is not None
            return self.learned.act_greedy(observation, find_legal(self.legal, state), rng or np.random.default_rng(0))
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
