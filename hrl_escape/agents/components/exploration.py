"""Exploration from action values: epsilon-greedy and Boltzmann, over legal actions only.

All functions are pure in values, mask and steps; samplers take a generator. Probabilities of policies are exact,
because expected SARSA needs them. Ornstein-Uhlenbeck noise for a continuous actor is at the end.
"""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.agent import AgentSettings
from hrl_escape.settings import Range


@dataclass(frozen=True, kw_only=True)
class ExplorationSettings(AgentSettings):
    """Exploration from action values."""

    epsilon_start: Annotated[float, Range(0, 1)] = 1.0
    """Epsilon at the beginning; 1 acts at random."""
    epsilon_end: Annotated[float, Range(0, 1)] = 0.05
    """Epsilon from `epsilon_steps` on. More explores for longer and lowers the return of training episodes."""
    epsilon_steps: Annotated[int, Range(1)] = 5_000
    """Number of clock steps of the linear decrease of epsilon. More explores for longer."""
    exploration: Literal["epsilon-greedy", "boltzmann"] = "epsilon-greedy"
    """`epsilon-greedy` draws evenly with probability epsilon. `boltzmann` draws by exp(q / temperature)."""
    temperature: Annotated[float, Range(0, open_low=True)] = 1.0
    """Temperature of `boltzmann`, in units of return. More explores more."""
    boltzmann_clip: Annotated[float, Range(0)] = 0.0
    """Bound on the size of q / temperature in `boltzmann`, as in keras-rl 0.4.2; values beyond it are equally likely. 0
    sets none."""


def make_rng(seed: int, stream: str) -> np.random.Generator:
    """Make a generator for one purpose; generators of one seed are independent of each other."""
    return np.random.default_rng([seed, *stream.encode()])


def mask_values(values: NDArray, mask: NDArray[np.bool_]) -> NDArray:
    """Replace values of illegal actions by -inf, which never wins a maximum. Shapes (..., actions)."""
    return np.where(mask, values, -np.inf)


def choose_best(values: NDArray, mask: NDArray[np.bool_], rng: np.random.Generator | None = None) -> int:
    """Return the legal action of highest value; among equal values a random one, or the first without `rng`.

    Shapes (actions,). Tables have exact ties before anything is learned, and always taking the lowest number would be a
    policy of its own. Networks have no exact ties; without `rng` their greedy policy stays a function of the state.
    """
    legal = mask_values(values, mask)
    best = int(legal.argmax())
    if rng is not None and np.count_nonzero(equal := legal == legal[best]) > 1:
        return sample_legal(equal, rng)
    return best


def compute_epsilon(settings: Any, steps: int) -> float:
    """Return epsilon after a number of steps: linear from `epsilon_start` to `epsilon_end`, then constant.

    `settings`, here and below, can be any object with the fields of `ExplorationSettings`.
    """
    progress = min(steps / settings.epsilon_steps, 1.0)
    return settings.epsilon_start + progress * (settings.epsilon_end - settings.epsilon_start)


def compute_exploration(values: Any, mask: Any, *, epsilon: float = 0.0, temperature: float = 0.0, clip: float = 0.0
                        ) -> Any:
    """Return the probabilities of an exploring policy, (..., actions): rows sum to 1, illegal actions have exactly 0.

    Args:
        values: arrays or tensors (..., actions), in units of return.
        mask: bool (..., actions), with at least one true in each row.
        epsilon: probability of a uniform action; other actions are the best. Ignored with a temperature.
        temperature: if above 0, probabilities are proportional to exp(value / temperature).
        clip: bound on the size of value / temperature; 0 sets none.
    """
    library: Any = np if isinstance(values, np.ndarray) else sys.modules["torch"]
    legal = library.where(mask, values, -np.inf)
    if temperature:
        scaled = legal / temperature
        if clip:
            scaled = library.clip(scaled, -clip, clip)
        weights = library.where(mask, library.exp(scaled - library.amax(scaled, -1)[..., None]), 0.0)
        return weights / weights.sum(-1)[..., None]
    if library is np and values.shape[:-1] == (1,):  # takes a third of the time of the form for many rows
        policy = mask * (epsilon / np.count_nonzero(mask))
        policy[0, legal[0].argmax()] += 1.0 - epsilon
        return policy
    columns = library.arange(values.shape[-1], device=values.device)
    is_best = columns == legal.argmax(-1)[..., None]
    return epsilon * mask / mask.sum(-1)[..., None] + (1.0 - epsilon) * is_best


def measure_conduct(policy: Any, values: Any, mask: Any, action: Any) -> dict[str, float]:
    """Return the entropy of exploring policies in nats, and the fraction of greedy choices, as means over the rows.

    Policies, values and masks are (n, actions), actions (n,), arrays or tensors. Without rows the result is empty.
    """
    if len(action) == 0:
        return {}
    if len(action) == 1:  # plain Python takes a tenth of the time for one row
        shares, row = policy[0].tolist(), values[0].tolist()
        best = max(value for value, is_legal in zip(row, mask[0].tolist(), strict=True) if is_legal)
        return {"entropy": -sum(share * math.log(share) for share in shares if share > 0),
                "greedy": float(row[int(action[0])] >= best)}
    library: Any = np if isinstance(values, np.ndarray) else sys.modules["torch"]
    entropy = -(policy * library.log(library.where(policy > 0, policy, 1.0))).sum(-1)
    best = library.amax(library.where(mask, values, -np.inf), -1)
    greedy = values[library.arange(len(values), device=values.device), action] >= best
    return {"entropy": float(entropy.sum()) / len(values), "greedy": float(greedy.sum()) / len(values)}


def compute_policy(values: NDArray, mask: NDArray[np.bool_], settings: Any, steps: int) -> NDArray[np.float64]:
    """Return the probabilities of the exploring policy after `steps` on the clock; see `compute_exploration`."""
    temperature = settings.temperature if settings.exploration == "boltzmann" else 0.0
    return compute_exploration(np.asarray(values, np.float64), mask, epsilon=compute_epsilon(settings, steps),
                               temperature=temperature, clip=settings.boltzmann_clip)


def compute_epsilon_greedy(values: NDArray, epsilon: float) -> NDArray[np.float64]:
    """Return epsilon-greedy probabilities over choices that are all legal; (choices,)."""
    policy = np.full(len(values), epsilon / len(values))
    policy[values.argmax()] += 1 - epsilon
    return policy


def compute_softmax(logits: NDArray) -> NDArray[np.float64]:
    """Return the softmax over the last axis, 0 for logits of -inf. Shapes (..., actions)."""
    weights = np.exp(logits.astype(np.float64) - logits.max(axis=-1, keepdims=True))
    return weights / weights.sum(axis=-1, keepdims=True)


def compute_choice_entropy(policy: NDArray) -> float:
    """Return the entropy of probabilities (actions,) in nats."""
    possible = policy[policy > 0]
    return float(-(possible * np.log(possible)).sum())


def compute_exploration_entropy(values: NDArray, mask: NDArray[np.bool_], settings: Any, steps: int
                                ) -> float:
    """Return the entropy of `compute_policy` in nats, in closed form for epsilon-greedy. Shapes (actions,)."""
    if settings.exploration == "boltzmann":
        return compute_choice_entropy(compute_policy(values, mask, settings, steps))
    others = int(np.count_nonzero(mask)) - 1
    other = compute_epsilon(settings, steps) / (others + 1)
    best = 1 - others * other
    return sum(-count * share * math.log(share) for count, share in ((1, best), (others, other)) if share > 0)


def sample_action(values: NDArray, mask: NDArray[np.bool_], settings: Any, steps: int, rng: np.random.Generator) -> int:
    """Draw one action from `compute_policy`. Shapes (actions,)."""
    if settings.exploration == "boltzmann":
        return sample_index(compute_policy(values, mask, settings, steps), rng)
    if rng.random() < compute_epsilon(settings, steps):
        return sample_legal(mask, rng)
    return choose_best(values, mask, rng)


def sample_legal(mask: NDArray[np.bool_], rng: np.random.Generator) -> int:
    """Draw a legal action uniformly."""
    legal = mask.nonzero()[0]
    return int(legal[rng.integers(len(legal))])


def sample_index(probabilities: NDArray[np.float64], rng: np.random.Generator) -> int:
    """Draw an index with given probabilities, (actions,); an index of probability 0 is never drawn."""
    cumulative = probabilities.cumsum()
    total = cumulative[-1]
    draw = rng.random() * total
    if draw >= total:  # the product may round up
        draw = np.nextafter(total, 0.0)
    return int(cumulative.searchsorted(draw, side="right"))


class OrnsteinUhlenbeck:
    """Correlated noise, x <- x - theta x dt + sigma sqrt(dt) n (Uhlenbeck and Ornstein 1930), started at 0.

    Attributes:
        state: current noise, float64 (size,).
    """

    def __init__(self, size: int, theta: float = 0.15, sigma: float = 0.3, dt: float = 0.01) -> None:
        self.theta, self.sigma, self.dt = theta, sigma, dt
        self.state = np.zeros(size)

    def reset(self) -> None:
        """Restart at 0, at the beginning of an episode."""
        self.state = np.zeros_like(self.state)

    def sample(self, rng: np.random.Generator) -> NDArray[np.float64]:
        """Return the next noise vector, (size,)."""
        drift = -self.theta * self.state * self.dt
        self.state = self.state + drift + self.sigma * np.sqrt(self.dt) * rng.standard_normal(len(self.state))
        return self.state
