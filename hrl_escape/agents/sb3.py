"""Algorithms of Stable-Baselines3 and sb3-contrib as agents that train.

`SB3Agent(PPO, n_steps=256)` acts with primitives and `SB3Agent(PPO, over_options=True)` chooses among options. Their
specs for the command line are `sb3(algorithm=PPO,arguments={"n_steps":256})` and `smdp-sb3(algorithm=PPO)`.

`learn` of the library runs in a thread of its own, which waits whenever the agent does not act or observe. So it trains
in the loop of `train`, with its budget, seeds and evaluations. The library discounts by decision: an option of k
primitives counts gamma, where agents of this package count gamma^k. Its state cannot be saved between episodes, so a
stopped run starts again.
"""

from __future__ import annotations

import inspect
import json
import threading
import weakref
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from importlib import import_module
from pkgutil import resolve_name
from queue import SimpleQueue
from typing import TYPE_CHECKING, Annotated, Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.agent import Agent, AgentSettings, SMDPTransition
from hrl_escape.agents.decisions import convert_action
from hrl_escape.agents.state import StateTree
from hrl_escape.errors import AgentSettingsError, MissingExtraError
from hrl_escape.settings import Range

if TYPE_CHECKING:
    from hrl_escape.agents.spec import AgentSpec

PACKAGES = ("stable_baselines3", "sb3_contrib")
"""Packages whose algorithms are known by name."""


@dataclass(frozen=True, kw_only=True)
class SB3Settings(AgentSettings):
    """Settings of an algorithm of Stable-Baselines3."""

    algorithm: str = "PPO"
    """Name in `stable_baselines3` or `sb3_contrib`, or the place of another class, `module:name`."""
    policy: str = ""
    """Policy of the library; empty for `MultiInputPolicy` with dictionaries and `MlpPolicy` otherwise."""
    gamma: Annotated[float, Range(0, 1)] = 0.99
    """Discount per decision."""
    arguments: dict[str, Any] = field(default_factory=dict)
    """Further arguments of the algorithm by name, such as n_steps; `env`, `seed` and `gamma` are given."""


def SB3Agent(algorithm: Any, policy: str = "", *, over_options: bool = False, label: str = "", gamma: float = 0.99,
             **arguments: Any) -> AgentSpec:
    """Return the spec of an algorithm of Stable-Baselines3 that trains with the loop of this package.

    Args:
        algorithm: class such as `stable_baselines3.PPO` or `sb3_contrib.MaskablePPO`, which is given the mask, or
            SAC for actions in a Box.
        policy: policy of the library; by default `MultiInputPolicy` with dictionaries and `MlpPolicy` otherwise.
        over_options: choose among options.
        label: name in tables and curves.
        gamma: discount per decision.
        **arguments: further arguments of the algorithm, as JSON values, such as `n_steps=256`.

    Raises:
        AgentSettingsError: the class is no algorithm.
    """
    from hrl_escape.agents.spec import AgentSpec

    if not (isinstance(algorithm, type) and hasattr(algorithm, "learn") and hasattr(algorithm, "predict")):
        raise AgentSettingsError("algorithm", algorithm, "a class of Stable-Baselines3, such as PPO")
    is_known = algorithm.__module__.partition(".")[0] in PACKAGES
    place = algorithm.__name__ if is_known else f"{algorithm.__module__}:{algorithm.__qualname__}"
    given = {"algorithm": place, "policy": policy, "gamma": gamma, "arguments": arguments}
    default = SB3Settings()
    settings = {name: value for name, value in given.items() if name == "algorithm" or value != getattr(default, name)}
    own = f"{algorithm.__name__} of SB3" + (" over options" if over_options else "")
    return AgentSpec("smdp-sb3" if over_options else "sb3", label or own, settings=settings)


class _Stopped(BaseException):
    """Raised in the thread of an agent that is no longer used."""


class _Feed(gymnasium.Env):
    """Environment of the library's thread: its calls wait for the decisions of the agent's loop."""

    def __init__(self, observation_space: gymnasium.Space, action_space: gymnasium.Space) -> None:
        self.observation_space, self.action_space = observation_space, action_space
        self.inbox: SimpleQueue[Any] = SimpleQueue()
        self.outbox: SimpleQueue[tuple[str, Any]] = SimpleQueue()
        self.mask: NDArray[np.bool_] | None = None

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Ask for the first observation of an episode."""
        return self._ask("reset", None), {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Hand over an action, and wait for its outcome."""
        return self._ask("action", convert_action(action, self.action_space))

    def action_masks(self) -> NDArray[np.bool_] | None:
        """Legal actions, as algorithms with masks ask for them."""
        return self.mask

    def _ask(self, kind: str, value: Any) -> Any:
        self.outbox.put((kind, value))
        answer = self.inbox.get()
        if answer is _Stopped:
            raise _Stopped
        return answer


class SB3Learner(Agent):
    """An algorithm of Stable-Baselines3 in the training loop of this package."""

    name = "sb3"
    settings: SB3Settings
    is_resumable = False
    acts_in = ("discrete", "box")

    def __init__(self, observation_space: gymnasium.Space, action_space: gymnasium.Space, seed: int,
                 settings: SB3Settings | None = None) -> None:
        self.settings = settings or SB3Settings()
        algorithm = find_algorithm(self.settings.algorithm)
        is_table = isinstance(observation_space, gymnasium.spaces.Dict)
        policy = self.settings.policy or ("MultiInputPolicy" if is_table else "MlpPolicy")
        self._feed = _Feed(observation_space, action_space)
        try:  # the library changes nested arguments, which are frozen in a spec
            given = {"device": "cpu", **json.loads(json.dumps(self.settings.arguments))}
            self.model = algorithm(policy, self._feed, seed=seed, gamma=self.settings.gamma, **given)
        except (TypeError, ValueError, AssertionError) as error:
            raise AgentSettingsError("sb3", str(self.settings.arguments), f"arguments of {algorithm.__name__} that fit "
                                     f"the environment ({' '.join(str(error).split())})") from error
        self._takes_masks = "action_masks" in inspect.signature(self.model.predict).parameters
        self._asked: tuple[str, Any] | None = None
        self._budget: int | None = None

    def note_budget(self, primitives: int) -> None:
        """Keep the length of training, which the library's schedules follow."""
        self._budget = primitives

    def act(self, observation: Any, action_mask: NDArray[np.bool_]) -> Any:
        """Return the action that the library chose, an int or float32 in the shape of a Box."""
        self._feed.mask = action_mask
        if self._asked is None:
            self._begin()
        if self._asked == ("reset", None):
            self._answer(observation)
        if self._asked is not None and self._asked[0] == "action":
            return self._asked[1]
        return self._predict(observation, action_mask, deterministic=False)  # the library ended its training

    def act_greedy(self, observation: Any, action_mask: NDArray[np.bool_], rng: np.random.Generator) -> Any:
        """Return the deterministic action."""
        return self._predict(observation, action_mask, deterministic=True)

    def observe(self, transition: SMDPTransition) -> Mapping[str, float]:
        """Hand the decision to the library, which learns before it asks for more."""
        self._feed.mask = transition.next_action_mask
        if self._asked is not None and self._asked[0] == "action":
            self._answer((transition.next_observation, float(transition.summed_reward), transition.terminated,
                          transition.truncated, {}))
        return {}

    def state_dict(self) -> StateTree:
        """Return the parameters of the policy, which evaluation needs; training cannot continue from them."""
        return {"policy": {name: value.detach().cpu().numpy()
                           for name, value in self.model.policy.state_dict().items()}}

    def load_state_dict(self, state: StateTree) -> None:
        """Restore the parameters of the policy."""
        import torch

        self.model.policy.load_state_dict({name: torch.as_tensor(np.array(value))
                                           for name, value in state["policy"].items()})

    def _predict(self, observation: Any, action_mask: NDArray[np.bool_], deterministic: bool) -> Any:
        masks = {"action_masks": action_mask} if self._takes_masks else {}
        action, _ = self.model.predict(observation, deterministic=deterministic, **masks)
        return convert_action(action, self._feed.action_space)

    def _begin(self) -> None:
        import torch

        feed, model, budget = self._feed, self.model, 10**9 if self._budget is None else self._budget
        threading.Thread(target=_learn, args=(model, feed, budget, torch.get_num_threads()), daemon=True).start()
        weakref.finalize(self, feed.inbox.put, _Stopped)
        self._asked = _read(feed)

    def _answer(self, value: Any) -> None:
        self._feed.inbox.put(value)
        self._asked = _read(self._feed)


def _learn(model: Any, feed: _Feed, budget: int, threads: int) -> None:
    import torch

    torch.set_num_threads(threads)  # a thread has a number of its own
    try:
        model.learn(budget)
        feed.outbox.put(("end", None))
    except _Stopped:
        pass
    except BaseException as error:  # raised in the thread of the training loop
        feed.outbox.put(("error", error))


def _read(feed: _Feed) -> tuple[str, Any]:
    kind, value = feed.outbox.get()
    if kind == "error":
        raise value
    return kind, value


def find_algorithm(place: str) -> Callable[..., Any]:
    """Return the class of an algorithm.

    Args:
        place: name in one of `PACKAGES`, or `module:name`.

    Raises:
        MissingExtraError: Stable-Baselines3 is not installed.
        AgentSettingsError: no such class.
    """
    if ":" in place:
        try:
            return resolve_name(place)
        except (ImportError, AttributeError, ValueError) as error:
            raise AgentSettingsError("algorithm", place, f"a class that can be imported ({error})") from error
    for library in PACKAGES:
        try:
            found = getattr(import_module(library), place, None)
        except ImportError as error:
            if library == PACKAGES[0]:
                raise MissingExtraError("stable-baselines3", "bench", "the agent sb3") from error
            continue
        if found is not None:
            return found
    raise AgentSettingsError("algorithm", place, "the name of a class in stable_baselines3 or sb3_contrib, such as PPO")
