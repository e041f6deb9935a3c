"""Exploration by random network distillation (Burda et al. 2018), an alternative to counts.

A network learns to predict the outputs of another network with fixed random weights. Its error is large at observations
unlike those it was trained on. It therefore replaces counts for observations that cannot be binned, such as pictures.

As in the paper, observations are whitened by their running mean and deviation and clipped to +-5. The paper learns a
separate value of novelty that ignores the ends of episodes, because an agent with one value for both rewards delays the
end to collect more novelty. Here one value holds both rewards, and the bonus is never positive, as with counts: the
error is divided by its running mean, capped at 1, and reduced by 1.
"""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import torch
from numpy.typing import NDArray

from hrl_escape.agents.components.bonuses import Bonus, CountBonus
from hrl_escape.agents.components.exploration import make_rng
from hrl_escape.agents.components.networks import Learner, ObservationEncoder, make_generator, make_network
from hrl_escape.agents.state import Kept

FEATURES = 32
"""Number of outputs of the random network."""
BATCH = 32
"""Number of observations in an update of the predictor; each is used once."""
LARGE_BATCH = 256
"""Most observations in an update, for batches of environments."""
CLIP = 5.0
"""Bound on whitened observations."""


class DistillationBonus(Bonus):
    """Prediction error of a random network's outputs, and the bonus computed from it.

    Args:
        seed: seed of the agent, which alone determines the weights.
        weight: largest cost of a familiar observation, in units of return.
        settings: settings of the agent's networks; the predictor uses their learning rate.
    """

    STATE = ("_learner", "_visits", "_errors", "_mean", "_squares", Kept("_kept_batch", "batch"))

    def __init__(self, space: gymnasium.Space, seed: int, weight: float, settings: Any, agent: str) -> None:
        self._weight = weight
        self._encoder = encoder = ObservationEncoder(space, settings.scale_observations)
        generator = make_generator(make_rng(seed, "distillation"))
        self._random = make_network(encoder, FEATURES, settings, generator).requires_grad_(False)
        self._predictor = make_network(encoder, FEATURES, settings, generator)
        networks = {"random": self._random, "predictor": self._predictor}
        self._learner = Learner(agent, networks, ["predictor"], settings)
        self._visits, self._errors = 0, 0.0
        self._mean, self._squares = np.zeros(encoder.shape), np.zeros(encoder.shape)
        self._batch: list[NDArray] = []

    def visit(self, observation: Any) -> float:
        """Learn from an observation; return its bonus before learning, at most 0, in units of return."""
        whitened = self._whiten(self._encoder.encode(observation))
        error = float(((self._predictor.compute(whitened) - self._random.compute(whitened)) ** 2).mean())
        self._errors += error
        self._batch.append(whitened)
        if len(self._batch) == BATCH:
            batch, self._batch = torch.from_numpy(np.stack(self._batch)), []
            self._learner.minimise(((self._predictor(batch) - self._random(batch)) ** 2).mean())
        share = error * self._visits / self._errors if self._errors else 1.0
        return self._weight * (min(share, 1.0) - 1.0)

    def visit_many(self, observation: NDArray) -> NDArray[np.float32]:
        """Learn from a batch of observations (n, ...); return their bonuses before learning, (n,).

        The predictor makes one update, on at most `LARGE_BATCH` evenly spaced observations.
        """
        if not len(observation):
            return np.zeros(0, np.float32)
        whitened = torch.from_numpy(self._whiten_many(self._encoder.encode_many(torch.from_numpy(observation)).numpy()))
        with torch.no_grad():
            errors = ((self._predictor(whitened) - self._random(whitened)) ** 2).mean(dim=1).numpy()
        self._errors += float(errors.sum())
        some = whitened[:: -(-len(whitened) // LARGE_BATCH)]
        self._learner.minimise(((self._predictor(some) - self._random(some)) ** 2).mean())
        shares = errors * (self._visits / self._errors) if self._errors else np.ones_like(errors)
        return (self._weight * (np.minimum(shares, 1.0) - 1.0)).astype(np.float32)

    def _whiten_many(self, encoded: NDArray) -> NDArray:
        """The same as `_whiten` for a batch, with moments over all of it (Chan, Golub and LeVeque 1983)."""
        before, self._visits = self._visits, self._visits + len(encoded)
        if self._encoder.is_image:
            return encoded
        mean = encoded.mean(axis=0, dtype=np.float64)
        apart = mean - self._mean
        self._mean = self._mean + apart * (len(encoded) / self._visits)
        self._squares = (self._squares + ((encoded - mean) ** 2).sum(axis=0)
                         + apart**2 * (before * len(encoded) / self._visits))
        return self._scale(encoded)

    def _scale(self, encoded: NDArray) -> NDArray:
        deviation = np.sqrt(self._squares / self._visits)
        return np.clip((encoded - self._mean) / np.maximum(deviation, 1e-6), -CLIP, CLIP).astype(np.float32)

    def _whiten(self, encoded: NDArray) -> NDArray:
        """Add an encoded observation to the running moments (Welford 1962), then whiten it; pictures stay bytes."""
        self._visits += 1
        if self._encoder.is_image:
            return encoded
        before = encoded - self._mean
        self._mean = self._mean + before / self._visits
        self._squares = self._squares + before * (encoded - self._mean)
        return self._scale(encoded)

    @property
    def _kept_batch(self) -> NDArray:
        """Whitened observations for the predictor's next update, (n, *observation shape)."""
        return np.array(self._batch, self._encoder.dtype).reshape(-1, *self._encoder.shape)

    @_kept_batch.setter
    def _kept_batch(self, saved: NDArray) -> None:
        self._batch = list(saved)


def make_bonus(space: gymnasium.Space, seed: int, settings: Any, agent: str) -> Bonus:
    """Make the bonus of an agent's settings; with a weight of 0 it is always 0.

    Raises:
        UnsupportedSpaceError: the bonus does not support the observations.
    """
    if settings.bonus_weight and settings.bonus == "distillation":
        return DistillationBonus(space, seed, settings.bonus_weight, settings, agent)
    return CountBonus(space, settings.bonus_weight, settings.bonus_bins, agent)
