"""Options over networks: their policies, values and terminations, and agents that learn them from rollouts.

The option is drawn from pi(o | s, o-) = (1 - beta_o-(s)) [o = o-] + beta_o-(s) pi_Omega(o | s), where o- ran before,
and in an episode's first state from pi_Omega. In many environments every stream runs an option of its own. What chose
is kept with a decision, its option and its action, for a decision that outlasts its rollout counts in the next one,
when the networks have moved on.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Iterator, Mapping
from typing import Any, ClassVar, NamedTuple

import gymnasium
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from hrl_escape.agents.agent import SMDPTransition, count_actions
from hrl_escape.agents.components.arrays import draw_minibatches
from hrl_escape.agents.components.exploration import choose_best, compute_softmax, make_rng, mask_values, sample_index
from hrl_escape.agents.components.networks import Learner, ObservationEncoder, make_generator, make_network
from hrl_escape.agents.components.option_agent import OptionAgent, OptionLog
from hrl_escape.agents.components.policy_gradient import (
    Rollout,
    compute_advantages,
    compute_clipped_parts,
    compute_log_policy,
    find_next,
    sample_policy,
    take_column,
)
from hrl_escape.agents.components.stream_rollouts import (
    collect_decisions,
    keep_decision,
    stack_decisions,
    unstack_decisions,
)
from hrl_escape.agents.state import Kept, Stateful, StateTree
from hrl_escape.agents.streams import OpenChoices, StreamAgent, StreamTransitions

NONE = -1
"""In place of the option before an episode's first decision."""
SMALLEST = 1e-12
"""Probability below which the logarithm of a choice is cut off."""


class OptionChoices(NamedTuple):
    """Options of the decisions of a rollout."""

    option: Tensor  # int64 (n,), that ran
    former: Tensor  # int64 (n,), that ran before it; `NONE` at an episode's first decision
    is_chosen: Tensor  # bool (n,), the former had ended, or there was none
    log_probability: Tensor | None = None
    """Float32 (n,), of the option that ran, as it was drawn; None where the networks are still those that drew."""


def mix_with_former(beta: Tensor, choice: Tensor, former: Tensor) -> Tensor:
    """pi(o | s, the option before), from beta and pi_Omega, all (n, options); with one option it is 1 to the bit."""
    kept = torch.nn.functional.one_hot(former.clamp(min=0), choice.shape[1]).to(choice.dtype)
    ends = beta.gather(1, former.clamp(min=0)[:, None]).masked_fill((former == NONE)[:, None], 1.0)
    return torch.where(ends == 1.0, choice, kept + ends * (choice - kept))


def mix_values(choice: Tensor, values: Tensor, former: Tensor) -> Tensor:
    """Sum over options of choice x Q(s, o), (n,) from (n, options); exact where one option has all of the choice."""
    base = take_column(values, former.clamp(min=0))
    return base + (choice * (values - base[:, None])).sum(dim=1)


class OpenOptions(Stateful):
    """The option that each stream runs, how it came to run, and for how many decisions it has run."""

    STATE = ("_option", "_former", "_is_chosen", "_log_probability", "_decisions", "_generator")

    def __init__(self, count: int, device: torch.device, rng: np.random.Generator) -> None:
        self._generator = torch.Generator(device).manual_seed(int(rng.integers(2**63)))
        self._option, self._former = (torch.full((count,), NONE, device=device) for _ in range(2))
        self._is_chosen = torch.ones(count, dtype=torch.bool, device=device)
        self._log_probability = torch.zeros(count, device=device)
        self._decisions = torch.zeros(count, dtype=torch.int64, device=device)
        self._over: list[Tensor] = []  # runs that are over: option and decisions, (2, n) each

    def draw(self, stream: Tensor, betas: Tensor, choice: Tensor) -> Tensor:
        """Draw whether the options of streams end, and the next ones; of a new episode, the first. Returns int64 (n,).

        `betas` are the terminations of all options where the streams are, `choice` the policy over options there, (n,
        options).
        """
        former = self._option[stream]
        draws = torch.rand(len(stream), generator=self._generator, device=stream.device)
        ends = (former == NONE) | (draws < take_column(betas, former.clamp(min=0)))
        option = torch.where(ends, sample_policy(choice.clamp(min=SMALLEST).log(), self._generator), former)
        chance = take_column(mix_with_former(betas, choice, former), option)
        self._finish(stream[ends & (former != NONE)])
        self._option[stream], self._former[stream], self._is_chosen[stream] = option, former, ends
        self._log_probability[stream] = chance.clamp(min=SMALLEST).log()
        return option

    def get_running(self, stream: Tensor) -> Tensor:
        """Options that some streams run, int64 (n,)."""
        return self._option[stream]

    def end(self, stream: Tensor, over: Tensor) -> OptionChoices:
        """Options of decisions that ended, int64 (n,); where the episode is `over` too, bool (n,), none goes on."""
        choices = OptionChoices(self._option[stream], self._former[stream], self._is_chosen[stream],
                                self._log_probability[stream])
        self._decisions[stream] += 1
        self._finish(stream[over])
        self._option[stream[over]] = NONE
        return choices

    def _finish(self, stream: Tensor) -> None:
        self._over.append(torch.stack((self._option[stream], self._decisions[stream])))
        self._decisions[stream] = 0

    def report(self, log: OptionLog) -> None:
        """Tell a log of the runs that are over since the last report, in order."""
        runs = torch.cat(self._over, dim=1).T.tolist() if self._over else []
        self._over = []
        for option, decisions in runs:
            log.add(option, decisions)

    def begin_episodes(self) -> None:
        """Drop the options that run: every stream begins an episode."""
        self._option.fill_(NONE)
        self._decisions.zero_()

    def after_load(self) -> None:
        """Forget the runs that are over: a log was told of them before the state was taken."""
        self._over = []


class OptionHeads:
    """Networks of a fixed number of options over encoded observations, and their optimiser.

    Args:
        settings: of the agent: those of networks, `options`, and `initial_termination` where options end.
        trained: names of the networks that are learned with `learning_rate`; empty for all.

    Attributes:
        networks: by name. `policy`: logits of every option's policy, (options x actions). `critic`: Q(s, o) in scaled
            return, (options,). `ending`: terminations before the logistic function and the shift of
            `initial_termination`, (options,). `chooser`: logits of the policy over options, (options,).
    """

    names: ClassVar[tuple[str, ...]] = ("policy", "critic", "ending", "chooser")

    def __init__(self, name: str, encoder: ObservationEncoder, actions: int, seed: int, settings: Any,
                 trained: tuple[str, ...] = ()) -> None:
        self.settings, self.options, self.actions, self._encoder = settings, settings.options, actions, encoder
        generator = make_generator(make_rng(seed, "weights"))
        self.networks = {}
        for head in self.names:
            outputs = self.options * (actions if head == "policy" else 1)
            gain = 1.0 if head == "critic" else 0.01
            self.networks[head] = make_network(encoder, outputs, settings, generator, 0, gain)
        self.policy, self.critic = self.networks["policy"], self.networks["critic"]
        self.learner = Learner(name, self.networks, trained or self.names, settings)

    @property
    def _shift(self) -> float:
        """Number added to the outputs of the network of terminations, so that 0 there is `initial_termination`."""
        return math.log(self.settings.initial_termination / (1 - self.settings.initial_termination))

    # --- of one observation ---------------------------------------------------------------

    def compute(self, network: str, observation: Any) -> NDArray[np.float64]:
        """Outputs of a network for one observation."""
        return self.networks[network].compute(self._encoder.encode(observation)).astype(np.float64)

    def compute_policies(self, observation: Any, action_mask: NDArray[np.bool_]) -> NDArray[np.float64]:
        """pi_o(a | s) over legal actions, float64 (options, actions)."""
        logits = self.compute("policy", observation).reshape(self.options, -1)
        return compute_softmax(mask_values(logits, action_mask))

    def compute_terminations(self, observation: Any) -> NDArray[np.float64]:
        """Probability that each option ends at the observation, beta_o(s), float64 (options,)."""
        return 1 / (1 + np.exp(-self.compute("ending", observation) - self._shift))

    def compute_option_policy(self, observation: Any) -> NDArray[np.float64]:
        """pi_Omega(o | s), float64 (options,)."""
        return compute_softmax(self.compute("chooser", observation))

    def compute_option_values(self, observation: Any) -> NDArray[np.float64]:
        """Q(s, .) of options, in units of return, float64 (options,)."""
        return self.compute("critic", observation) / self.settings.reward_scale

    # --- of many, on their device ---------------------------------------------------------

    def compute_log_policies(self, observation: Tensor, option: Tensor, mask: Tensor) -> Tensor:
        """Log probabilities of the actions of one option a row, (n, actions)."""
        logits = self.policy(observation).view(len(option), self.options, self.actions)
        return compute_log_policy(logits[torch.arange(len(option), device=option.device), option], mask)

    def compute_betas(self, observation: Tensor) -> Tensor:
        """beta_o(s) of all options, (n, options)."""
        return torch.sigmoid(self.networks["ending"](observation) + self._shift)

    def compute_option_choice(self, observation: Tensor, former: Tensor) -> Tensor:
        """pi(o | s, the option before), (n, options)."""
        return mix_with_former(self.compute_betas(observation), self.compute_fresh_choice(observation), former)

    def compute_fresh_choice(self, observation: Tensor) -> Tensor:
        """pi_Omega(o | s), (n, options)."""
        return torch.softmax(self.networks["chooser"](observation), dim=1)

    # --- learning ---------------------------------------------------------------------------

    def compute_next_values(self, rollout: Rollout, choices: OptionChoices) -> tuple[Tensor, Tensor]:
        """Values of the states reached, (n,) each: of the option that ran next, and before that one was drawn.

        Where none ran next in the rollout, because the episode was cut or the rollout ended, both are the latter.
        """
        values = self.critic(rollout.next_observation)
        mean = mix_values(self.compute_option_choice(rollout.next_observation, choices.option), values, choices.option)
        after, goes_on = find_next(rollout)
        return torch.where(goes_on, take_column(values, choices.option[after]), mean), mean

    def compute_advantages(self, rollout: Rollout, choices: OptionChoices, values: Tensor, cost: float) -> Tensor:
        """Advantages of actions within options, (n,); ending an option costs `cost`, in scaled return, upon arrival."""
        next_values, _ = self.compute_next_values(rollout, choices)
        betas = take_column(self.compute_betas(rollout.next_observation), choices.option)
        after, goes_on = find_next(rollout)
        ends = torch.where(goes_on, choices.is_chosen[after].float(), betas)
        return compute_advantages(rollout, values, next_values - cost * ends, self.settings)

    def compute_termination_loss(self, reached: Tensor, goes_on: Tensor, option: Tensor, margin: float) -> Tensor:
        """Mean of beta_o(s') (Q(s', o) - V(s') + margin) over decisions, 0 where the task ended, ().

        `reached` are the states s', encoded, (n, ...), at which the task goes on or not, bool (n,); the margin is in
        scaled return.

        V(s') is the mean of Q(s', .) over the policy over options, and only beta has a gradient.
        """
        with torch.no_grad():
            values = self.critic(reached)
            worse = take_column(values, option) - mix_values(self.compute_fresh_choice(reached), values, option)
        return (take_column(self.compute_betas(reached), option) * (worse + margin) * goes_on).mean()

    def compute_old_log_probability(self, rollout: Rollout, choices: OptionChoices) -> Tensor:
        """Log probability of each action when it was chosen, (n,); while the networks are those that chose."""
        if choices.log_probability is not None:
            return rollout.log_probability
        return take_column(self.compute_log_policies(rollout.observation, choices.option, rollout.mask),
                           rollout.action)

    def compute_option_loss(self, observation: Tensor, mask: Tensor, option: Tensor, action: Tensor,
                            old_log_probability: Tensor, advantage: Tensor, target: Tensor) -> dict[str, Tensor]:
        """PPO's loss of actions within options over a minibatch, and its parts.

        Observations are encoded, (n, ...), the mask is bool (n, actions), all others are (n,); the target is that of
        Q(s, o).
        """
        log_policy = self.compute_log_policies(observation, option, mask)
        values = take_column(self.critic(observation), option)
        return compute_clipped_parts(log_policy, mask, action, values, old_log_probability, advantage, target,
                                     self.settings)


# --- agents -------------------------------------------------------------------------------


class StreamOptionAgent(OptionAgent, StreamAgent):
    """Base of agents that learn options over networks from rollouts, with `stream_rollout` among the settings."""

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
        self._former, self._is_chosen = self._option, True
        self._option, self._decisions = sample_index(self.heads.compute_option_policy(observation), self._option_rng), 0

    def act_greedy(self, observation: Any, action_mask: NDArray[np.bool_], rng: np.random.Generator) -> int:
        """The likeliest action of an option: the likeliest one, given that which ran in `rng`'s evaluation."""
        choice, decisions = self.heads.compute_option_policy(observation), 0
        if (known := self.recall(rng)) is not None:
            running, decisions = known
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
        """Everything that was collected."""
        if self._rows:
            return stack_decisions(self._rows, 0), OptionChoices(*map(torch.tensor, zip(*self._choices, strict=True)))
        rollouts, choices = zip(*self._chunks, strict=True)
        return (Rollout(*map(torch.cat, zip(*rollouts, strict=True))),
                OptionChoices(*map(torch.cat, zip(*choices, strict=True))))

    def _draw_batches(self, units: int, collected: int) -> Iterator[Tensor]:
        """Minibatches of rows, as many as of `rollout` decisions; none of one row, which has no deviation."""
        size = self.settings.batch_size
        size = max(size, collected * size // self.settings.rollout)
        batches = draw_minibatches(self._batch_rng, units, size, self.settings.epochs)
        return (rows.to(self.heads.policy.weights.device) for rows in batches if len(rows) > 1)

    @abstractmethod
    def _learn(self, rollout: Rollout, choices: OptionChoices) -> Mapping[str, float]:
        """The updates from a rollout, while the networks are still those that chose; returns numbers to log."""

    # --- streams ------------------------------------------------------------------------

    def move(self, device: torch.device) -> None:
        """Move networks, optimisers and what waits for updates to a device."""
        self.heads.learner.move(device)

    def begin_streams(self, count: int, device: torch.device) -> None:
        """Move to a device; every stream begins an episode, and what was collected ends there, as truncated."""
        if self._open is not None and self._open[0].has(count, device):
            if self._collected:
                rollout, choices = self._gather()
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
        rollout, own = self._gather()
        self._forget()
        choices.begin_rollout()
        options.report(self.log)
        return dict(self._learn(rollout, own)) | self.log.measure()

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
        rollout, own = (part._asdict() for part in self._gather()) if self._collected else (None, None)
        return {"rollout": rollout, "own": own,
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
