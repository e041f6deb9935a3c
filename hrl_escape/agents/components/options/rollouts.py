"""Agents that learn options over networks from rollouts, of one environment or of many.

In many, every stream runs an option of its own. What chose is kept with a decision, its option and its action, for a
decision that outlasts its rollout counts in the next one, when the networks have moved on.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator, Mapping
from typing import Any, ClassVar

import gymnasium
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from hrl_escape.agents.agent import SMDPTransition, count_actions
from hrl_escape.agents.components.exploration import choose_best, make_rng, sample_index
from hrl_escape.agents.components.networks import ObservationEncoder
from hrl_escape.agents.components.options.agent import OptionAgent
from hrl_escape.agents.components.options.networks import NONE, OpenOptions, OptionChoices, OptionHeads
from hrl_escape.agents.components.policy_gradient import (
    Rollout,
    collect_decisions,
    draw_minibatches,
    keep_decision,
    sample_policy,
    stack_decisions,
    take_column,
    unstack_decisions,
)
from hrl_escape.agents.state import Kept, StateTree
from hrl_escape.agents.streams import OpenChoices, StreamAgent, StreamTransitions


class StreamOptionAgent(OptionAgent, StreamAgent):
    """Base of agents that learn options over networks from rollouts, with `stream_rollout` among the settings."""

    name: ClassVar[str]
    Heads: ClassVar[type[OptionHeads]] = OptionHeads
    trained: ClassVar[tuple[str, ...]] = ()
    """Networks that are learned with `learning_rate`; empty for all."""
    settings: Any
    is_markov: bool = False
    STATE = (Kept("_kept_rollout", "rollout", unpack=dict), Kept("_kept_choices", "choices", unpack=dict), "log",
             "_running", "_action_rng", "_option_rng", "_batch_rng", Kept("heads.learner", "learner"),
             Kept("_stream_rng", is_left_out=True), Kept("_stream_option_rng", is_left_out=True),
             Kept("_kept_streams", "streams", unpack=dict, is_left_out=True))

    def __init__(self, observation_space: gymnasium.Space, action_space: gymnasium.Space, seed: int,
                 settings: Any = None) -> None:
        self.settings = settings = settings or self.Settings()
        super().__init__(settings.options, self.name)
        self._encoder = ObservationEncoder(observation_space, settings.scale_observations)
        self._actions = count_actions(action_space, self.name)
        self.heads = self.Heads(self.name, self._encoder, self._actions, seed, settings, self.trained)
        self._action_rng, self._option_rng = make_rng(seed, "actions"), make_rng(seed, "options")
        self._batch_rng = make_rng(seed, "batches")
        self._stream_rng, self._stream_option_rng = make_rng(seed, "streams"), make_rng(seed, "streams' options")
        self._former, self._is_chosen = NONE, True
        self._open: tuple[OpenChoices, OpenOptions] | None = None  # None while one environment is played
        self._forget()

    def _forget(self) -> None:
        """Begin an empty rollout."""
        self._rows: list[tuple] = []
        self._choices: list[tuple[int, int, bool]] = []
        self._chunks: list[tuple[Rollout, OptionChoices]] = []  # of streams
        self._collected = 0

    def compute_policies(self, observation: Any, action_mask: NDArray[np.bool_]) -> NDArray[np.float64]:
        """pi_o(a | s) over legal actions, float64 (options, actions)."""
        return self.heads.compute_policies(observation, action_mask)

    def compute_terminations(self, observation: Any) -> NDArray[np.float64]:
        """Probability that each option ends at the observation, beta_o(s), float64 (options,)."""
        return self.heads.compute_terminations(observation)

    def compute_preferences(self, observation: Any) -> NDArray:
        """Logits of the policy of the likeliest option at an observation, before any mask, (actions,)."""
        option = int(self.heads.compute_option_policy(observation).argmax())
        return self.heads.compute("policy", observation).reshape(self.options, -1)[option]

    def compute_state_value(self, observation: Any) -> float:
        """Mean of Q(s, o) over the policy over options, in units of return."""
        return float(self.heads.compute_option_policy(observation) @ self.heads.compute_option_values(observation))

    # --- acting -------------------------------------------------------------------------

    def act(self, observation: Any, action_mask: NDArray[np.bool_]) -> int:
        """Draw from the running option's policy; a first option is drawn in a new episode."""
        if self._option == NONE:
            self._choose(observation)
        self._shown = self._option, self._decisions, observation
        return sample_index(self.compute_policies(observation, action_mask)[self._option], self._action_rng)

    def _choose(self, observation: Any) -> None:
        """Draw an option from the policy over options."""
        self._former, self._is_chosen = self._option, True
        self._option, self._decisions = sample_index(self.heads.compute_option_policy(observation), self._option_rng), 0

    def act_greedy(self, observation: Any, action_mask: NDArray[np.bool_], rng: np.random.Generator) -> int:
        """The likeliest action of an option: the likeliest one, given that which ran in `rng`'s evaluation."""
        choice, decisions = self.heads.compute_option_policy(observation), 0
        if self._evaluation is not None and self._evaluation[0] is rng:
            _, running, decisions = self._evaluation
            ends = self.compute_terminations(observation)[running]
            choice = ends * choice
            choice[running] += 1 - ends
            decisions = decisions if int(choice.argmax()) == running else 0
        option = int(choice.argmax())
        self._evaluation = rng, option, decisions + 1
        self._shown = option, decisions, observation
        return choose_best(self.heads.compute("policy", observation).reshape(self.options, -1)[option], action_mask)

    # --- learning -----------------------------------------------------------------------

    def observe(self, transition: SMDPTransition) -> Mapping[str, float]:
        """Keep the decision; update when the rollout is full. Streams are over with it, and what they collected."""
        if self._open is not None:
            self._open = None
            self._forget()
        self._rows.append(keep_decision(transition, self._encoder, self.settings, np.zeros(0, np.float32)))
        self._choices.append((self._option, self._former, self._is_chosen))
        self._decisions += 1
        metrics: dict[str, float] = {}
        if len(self._rows) >= self.settings.rollout:
            rollout, choices = self._gather()
            self._forget()
            metrics = dict(self._learn(rollout, choices)) | self.log.measure()
        self._go_on(transition.next_observation, transition.terminated or transition.truncated)
        return metrics

    def _go_on(self, observation: Any, over: bool) -> None:
        """Draw whether the option ends, and the next."""
        if over:
            self.log.add(self._option, self._decisions)
            self._option, self._decisions = NONE, 0
        elif self._option_rng.random() < self.compute_terminations(observation)[self._option]:
            self.log.add(self._option, self._decisions)
            self._choose(observation)
        else:
            self._former, self._is_chosen = self._option, False

    def _gather(self) -> tuple[Rollout, OptionChoices]:
        return stack_decisions(self._rows, 0), OptionChoices(*map(torch.tensor, zip(*self._choices, strict=True)))

    def _draw_batches(self, units: int, collected: int) -> Iterator[Tensor]:
        """Minibatches of rows, as many as of `rollout` decisions; none of one row, which has no deviation."""
        size = self.settings.batch_size
        size = max(size, collected * size // self.settings.rollout)
        batches = draw_minibatches(self._batch_rng, units, size, self.settings.epochs)
        return (rows.to(self.heads.policy.weights.device) for rows in batches if len(rows) > 1)

    @abstractmethod
    def _learn(self, rollout: Rollout, choices: OptionChoices) -> Mapping[str, float]:
        """The updates from a rollout; returns numbers to log.

        The networks are still those that chose.
        """

    # --- streams ------------------------------------------------------------------------

    def move(self, device: torch.device) -> None:
        """Move networks, optimisers and what waits for updates to a device."""
        self.heads.move(device)

    def begin_streams(self, count: int, device: torch.device) -> None:
        """Move to a device; every stream begins an episode, and what was collected ends there.

        Where streams begin anew in the middle of a rollout, its decisions stay, and their episodes count as truncated.
        """
        if self._open is not None and self._open[0].has(count, device):
            if self._collected:
                rollout, choices = self._gather_chunks()
                over = rollout.over | self._open[0].find_last(rollout.stream, rollout.place)
                self._chunks = [(rollout._replace(over=over), choices)]
            for each in self._open:
                each.begin_episodes()
            return
        self.move(device)
        self._open = (OpenChoices(count, self._actions, device, self._stream_rng),
                      OpenOptions(count, device, self._stream_option_rng))
        self._forget()

    def act_streams(self, observation: Tensor, mask: Tensor, stream: Tensor) -> Tensor:
        """Draw each stream's option, then its action from that option's policy."""
        assert self._open is not None, "begin_streams comes first"
        choices, options = self._open
        seen = self._encoder.encode_many(observation)
        with torch.no_grad():
            option = options.draw(stream, self.heads.compute_betas(seen), self.heads.compute_fresh_choice(seen))
            log_policy = self.heads.compute_log_policies(seen, option, mask)
        action = sample_policy(log_policy, choices.generator)
        choices.choose(stream, mask, take_column(log_policy, action), choices.memory[stream])
        return action

    def observe_streams(self, decisions: StreamTransitions) -> Mapping[str, float]:
        """Keep the decisions; update when the rollout is full."""
        assert self._open is not None, "begin_streams comes first"
        choices, options = self._open
        rollout = collect_decisions(choices, decisions, self._encoder, self.settings)
        self._chunks.append((rollout, options.end(decisions.stream, rollout.over)))
        self._collected += len(decisions.stream)
        if self._collected < max(self.settings.rollout, self.settings.stream_rollout * choices.count):
            return {}
        rollout, own = self._gather_chunks()
        self._forget()
        choices.begin_rollout()
        options.report(self.log)
        return dict(self._learn(rollout, own)) | self.log.measure()

    def _gather_chunks(self) -> tuple[Rollout, OptionChoices]:
        """The rollout of the streams so far, as one."""
        rollouts, choices = zip(*self._chunks, strict=True)
        return (Rollout(*map(torch.cat, zip(*rollouts, strict=True))),
                OptionChoices(*map(torch.cat, zip(*choices, strict=True))))

    # --- state ----------------------------------------------------------------------------

    @property
    def _kept_rollout(self) -> dict[str, Tensor] | None:
        return stack_decisions(self._rows, 0)._asdict() if self._rows else None

    @_kept_rollout.setter
    def _kept_rollout(self, saved: Mapping[str, Any]) -> None:
        self._rows = unstack_decisions(saved)

    @property
    def _kept_choices(self) -> dict[str, Tensor] | None:
        return self._gather()[1]._asdict() if self._choices else None

    @_kept_choices.setter
    def _kept_choices(self, saved: Mapping[str, Any]) -> None:
        columns = (np.asarray(saved[name]).tolist() for name in ("option", "former", "is_chosen"))
        self._choices = list(zip(*columns, strict=True))

    @property
    def _running(self) -> list[int]:
        """Option that runs, that before it, whether it was chosen, and the decisions it has made."""
        return [self._option, self._former, int(self._is_chosen), self._decisions]

    @_running.setter
    def _running(self, saved: list[int]) -> None:
        self._option, self._former, is_chosen, self._decisions = map(int, saved)
        self._is_chosen = bool(is_chosen)

    def load_state_dict(self, state: StateTree) -> None:
        """Restore the result of `state_dict`."""
        self._forget()
        super().load_state_dict(state)
        self._evaluation = None

    def state_dict(self) -> StateTree:
        """Everything that `STATE` names, once the log knows of the runs of options that are over."""
        if self._open is not None:
            self._open[1].report(self.log)
        return super().state_dict()

    @property
    def _kept_streams(self) -> StateTree | None:
        """The rollout of the streams so far, and their choices in progress; None while one environment is played."""
        if self._open is None:
            return None
        rollout, own = self._gather_chunks() if self._collected else (None, None)
        return {"rollout": None if rollout is None else rollout._asdict(),
                "own": None if own is None else own._asdict(),
                "choices": self._open[0].state_dict(), "options": self._open[1].state_dict()}

    @_kept_streams.setter
    def _kept_streams(self, saved: StateTree | None) -> None:
        """Streams go on if there are as many, on any device."""
        if self._open is None or saved is None:
            return
        for each, name in zip(self._open, ("choices", "options"), strict=True):
            each.load_state_dict(saved[name])
        if saved["rollout"] is not None:
            fields, own = ({name: torch.from_numpy(np.asarray(field)).to(self.heads.policy.weights.device)
                            for name, field in saved[part].items()} for part in ("rollout", "own"))
            self._chunks, self._collected = [(Rollout(**fields), OptionChoices(**own))], len(fields["place"])
