"""Options over networks: their policies, values and terminations, and agents that learn them from rollouts.

The option is drawn from pi(o | s, o-) = (1 - beta_o-(s)) [o = o-] + beta_o-(s) pi_Omega(o | s), where o- ran before,
and in an episode's first state from pi_Omega. Each of many environments runs its own option. A decision is stored with
the probabilities of its option and action. A decision that outlasts its rollout counts in the next, after the networks
have changed.
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

from hrl_escape.agents.agent import SMDPTransition, compute_backup, count_actions
from hrl_escape.agents.batch_agent import BatchAgent
from hrl_escape.agents.components.arrays import draw_minibatches, draw_rows
from hrl_escape.agents.components.exploration import choose_best, compute_softmax, make_rng, mask_values, sample_index
from hrl_escape.agents.components.networks import Learner, ObservationEncoder, make_generator, make_network
from hrl_escape.agents.components.option_agent import OptionAgent, OptionLog
from hrl_escape.agents.components.policy_gradient import (
    Rollout,
    compute_advantages,
    compute_clipped_parts,
    compute_entropy,
    compute_log_policy,
    find_next,
    take_column,
)
from hrl_escape.agents.components.rollout_rows import keep_decision, stack_decisions, unstack_decisions
from hrl_escape.agents.decisions import AgentPolicy, Decisions, Moments, Policy, read_decision
from hrl_escape.agents.state import Kept, Stateful, StateTree

NONE = -1
"""In place of the option before an episode's first decision."""
OVER = 6
"""Place of `over` in a row of `rollout_rows`."""
SMALLEST = 1e-12
"""Probability below which the logarithm of a choice is cut off."""


class OptionChoices(NamedTuple):
    """Options of the decisions of a rollout."""

    option: Tensor  # int64 (n,), the running option
    former: Tensor  # int64 (n,), the option before it; `NONE` at an episode's first decision
    is_chosen: Tensor  # bool (n,), true if the former option had ended, or at the first decision
    log_probability: Tensor | None = None
    """Float32 (n,), of the running option when it was drawn, or None if the networks are unchanged since."""


def mix_with_former(beta: Tensor, choice: Tensor, former: Tensor) -> Tensor:
    """Return pi(o | s, former option) from beta and pi_Omega, all (n, options); exactly 1 with one option."""
    kept = torch.nn.functional.one_hot(former.clamp(min=0), choice.shape[1]).to(choice.dtype)
    ends = beta.gather(1, former.clamp(min=0)[:, None]).masked_fill((former == NONE)[:, None], 1.0)
    return torch.where(ends == 1.0, choice, kept + ends * (choice - kept))


def mix_values(choice: Tensor, values: Tensor, former: Tensor) -> Tensor:
    """Return the sum over options of choice x Q(s, o), (n,) from (n, options); exact for a certain choice."""
    base = take_column(values, former.clamp(min=0))
    return base + (choice * (values - base[:, None])).sum(dim=1)


class OpenOptions(Stateful):
    """The running option of each of many environments, its choice, and its number of decisions."""

    STATE = ("_option", "_former", "_is_chosen", "_log_probability", "_decisions", "_generator")

    def __init__(self, num_envs: int, device: torch.device, rng: np.random.Generator) -> None:
        self._generator = torch.Generator(device).manual_seed(int(rng.integers(2**63)))
        self._option, self._former = (torch.full((num_envs,), NONE, device=device) for _ in range(2))
        self._is_chosen = torch.ones(num_envs, dtype=torch.bool, device=device)
        self._log_probability = torch.zeros(num_envs, device=device)
        self._decisions = torch.zeros(num_envs, dtype=torch.int64, device=device)
        self._over: list[Tensor] = []  # finished runs: option and decisions, (2, n) each

    def draw(self, env: Tensor, betas: Tensor, choice: Tensor) -> Tensor:
        """Sample terminations of the options of some environments, and the next options; in a new episode, the first.

        Args:
            env: int64 (n,).
            betas: terminations of all options at the states, (n, options).
            choice: policy over options at the states, (n, options).

        Returns:
            Options, int64 (n,).
        """
        former = self._option[env]
        draws = torch.rand(len(env), generator=self._generator, device=env.device)
        ends = (former == NONE) | (draws < take_column(betas, former.clamp(min=0)))
        option = torch.where(ends, draw_rows(choice, self._generator), former)
        chance = take_column(mix_with_former(betas, choice, former), option)
        self._finish(env[ends & (former != NONE)])
        self._option[env], self._former[env], self._is_chosen[env] = option, former, ends
        self._log_probability[env] = chance.clamp(min=SMALLEST).log()
        return option

    def get_running(self, env: Tensor) -> Tensor:
        """Return the running options of some environments, int64 (n,)."""
        return self._option[env]

    def end(self, env: Tensor, over: Tensor) -> OptionChoices:
        """Return the options of decisions that ended, int64 (n,), and drop options where `over`, bool (n,), is set."""
        choices = OptionChoices(self._option[env], self._former[env], self._is_chosen[env], self._log_probability[env])
        self._decisions[env] += 1
        self._finish(env[over])
        self._option[env[over]] = NONE
        return choices

    def _finish(self, env: Tensor) -> None:
        self._over.append(torch.stack((self._option[env], self._decisions[env])))
        self._decisions[env] = 0

    def report(self, log: OptionLog) -> None:
        """Add the runs that ended since the last report to a log, in order."""
        runs = torch.cat(self._over, dim=1).T.tolist() if self._over else []
        self._over = []
        for option, decisions in runs:
            log.add(option, decisions)

    def begin_episodes(self) -> None:
        """Drop running options: every environment begins an episode."""
        self._option.fill_(NONE)
        self._decisions.zero_()

    def after_load(self) -> None:
        """Drop finished runs: they were logged before the state was saved."""
        self._over = []


class OptionRollout(Stateful):
    """Decisions of many environments for the next updates, and the generator of their actions.

    Attributes:
        generator: on the device, for the draws of actions.
    """

    STATE = ("_log_probability", "_place", "generator", Kept("_rows", "rows", unpack=dict))

    def __init__(self, num_envs: int, device: torch.device, rng: np.random.Generator) -> None:
        self.generator = torch.Generator(device).manual_seed(int(rng.integers(2**63)))
        self._log_probability = torch.zeros(num_envs, device=device)
        self._place = torch.zeros(num_envs, dtype=torch.int64, device=device)
        self._parts: list[tuple[Rollout, OptionChoices]] = []
        self._count = 0

    def __len__(self) -> int:
        return self._count

    def note_choice(self, env: Tensor, log_probability: Tensor) -> None:
        """Store log probabilities, (n,), of the latest actions in some environments, int64 (n,)."""
        self._log_probability[env] = log_probability

    def add(self, batch: Decisions, choices: OptionChoices, encoder: ObservationEncoder, settings: Any) -> None:
        """Add decisions that ended, with their options."""
        reward, bootstrap = compute_backup(batch, settings)
        env, over = batch.env, batch.terminated | batch.truncated
        self._parts.append((Rollout(
            encoder.encode_many(batch.observation), batch.action_mask, batch.action, self._log_probability[env],
            reward * settings.reward_scale, bootstrap, batch.duration, over,
            encoder.encode_many(batch.next_observation), self._log_probability.new_zeros((len(env), 0)), env,
            self._place[env]), choices))
        self._place[env] += 1
        self._count += len(env)

    def gather(self) -> tuple[Rollout, OptionChoices]:
        """Return the collected decisions."""
        rollouts, choices = zip(*self._parts, strict=True)
        return (Rollout(*map(torch.cat, zip(*rollouts, strict=True))),
                OptionChoices(*map(torch.cat, zip(*choices, strict=True))))

    def take(self) -> tuple[Rollout, OptionChoices]:
        """Return the collected decisions, and begin the next rollout."""
        taken = self.gather()
        self._parts, self._count = [], 0
        self._place.zero_()
        return taken

    def truncate(self) -> None:
        """End the episode of every environment with its latest decision here."""
        if self._count:
            rollout, choices = self.gather()
            over = rollout.over | (rollout.place == self._place[rollout.stream] - 1)
            self._parts = [(rollout._replace(over=over), choices)]

    @property
    def _rows(self) -> StateTree | None:
        """Fields of the collected decisions, or None without any."""
        return {"rollout": self.gather()[0]._asdict(), "own": self.gather()[1]._asdict()} if self._count else None

    @_rows.setter
    def _rows(self, saved: StateTree | None) -> None:
        self._parts, self._count = [], 0
        if saved is not None:
            fields, own = ({name: torch.from_numpy(np.asarray(field)).to(self._place.device)
                            for name, field in saved[part].items()} for part in ("rollout", "own"))
            self._parts, self._count = [(Rollout(**fields), OptionChoices(**own))], len(fields["place"])


class OptionHeads:
    """Networks of a fixed number of options over encoded observations, and their optimiser.

    Args:
        settings: of the agent: its networks, `options`, and `initial_termination` if options end.
        trained: names of the networks with the step size `learning_rate`; empty for all.

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
        """Offset of the outputs of the network of terminations: an output of 0 means `initial_termination`."""
        return math.log(self.settings.initial_termination / (1 - self.settings.initial_termination))

    # --- one observation ------------------------------------------------------------------

    def compute(self, network: str, observation: Any) -> NDArray[np.float64]:
        """Return the outputs of a network for one observation."""
        return self.networks[network].compute(self._encoder.encode(observation)).astype(np.float64)

    def compute_policies(self, observation: Any, action_mask: NDArray[np.bool_]) -> NDArray[np.float64]:
        """pi_o(a | s) over legal actions, float64 (options, actions)."""
        logits = self.compute("policy", observation).reshape(self.options, -1)
        return compute_softmax(mask_values(logits, action_mask))

    def compute_terminations(self, observation: Any) -> NDArray[np.float64]:
        """Probability that each option ends at the observation, beta_o(s), float64 (options,)."""
        return 1 / (1 + np.exp(-self.compute("ending", observation) - self._shift))

    def compute_option_policy(self, observation: Any) -> NDArray[np.float64]:
        """Return pi_Omega(o | s), float64 (options,)."""
        return compute_softmax(self.compute("chooser", observation))

    def compute_option_values(self, observation: Any) -> NDArray[np.float64]:
        """Return Q(s, .) of options, in units of return, float64 (options,)."""
        return self.compute("critic", observation) / self.settings.reward_scale

    # --- many observations, on their device -----------------------------------------------

    def compute_log_policies(self, observation: Tensor, option: Tensor, mask: Tensor) -> Tensor:
        """Return log probabilities of actions, for one option per row, (n, actions)."""
        logits = self.policy(observation).view(len(option), self.options, self.actions)
        return compute_log_policy(logits[torch.arange(len(option), device=option.device), option], mask)

    def compute_betas(self, observation: Tensor) -> Tensor:
        """Return beta_o(s) of all options, (n, options)."""
        return torch.sigmoid(self.networks["ending"](observation) + self._shift)

    def compute_option_choice(self, observation: Tensor, former: Tensor) -> Tensor:
        """Return pi(o | s, former option), (n, options)."""
        return mix_with_former(self.compute_betas(observation), self.compute_fresh_choice(observation), former)

    def compute_fresh_choice(self, observation: Tensor) -> Tensor:
        """Return pi_Omega(o | s), (n, options)."""
        return torch.softmax(self.networks["chooser"](observation), dim=1)

    # --- learning ---------------------------------------------------------------------------

    def compute_next_values(self, rollout: Rollout, choices: OptionChoices) -> tuple[Tensor, Tensor]:
        """Return the values of next states, (n,) each: of the next option, and before that option was drawn.

        Without a next option, because the episode was cut or the rollout ended, both are the latter.
        """
        values = self.critic(rollout.next_observation)
        mean = mix_values(self.compute_option_choice(rollout.next_observation, choices.option), values, choices.option)
        after, goes_on = find_next(rollout)
        return torch.where(goes_on, take_column(values, choices.option[after]), mean), mean

    def compute_advantages(self, rollout: Rollout, choices: OptionChoices, values: Tensor, cost: float) -> Tensor:
        """Return advantages of actions within options, (n,); ending an option costs `cost`, in scaled return."""
        next_values, _ = self.compute_next_values(rollout, choices)
        betas = take_column(self.compute_betas(rollout.next_observation), choices.option)
        after, goes_on = find_next(rollout)
        ends = torch.where(goes_on, choices.is_chosen[after].float(), betas)
        return compute_advantages(rollout, values, next_values - cost * ends, self.settings)

    def compute_termination_loss(self, reached: Tensor, goes_on: Tensor, option: Tensor, margin: float) -> Tensor:
        """Return the mean of beta_o(s') (Q(s', o) - V(s') + margin) over decisions, 0 where the task ended, ().

        `reached` are the states s', encoded, (n, ...), with a flag whether the task continues, bool (n,); the margin is
        in scaled return.

        V(s') is the mean of Q(s', .) over the policy over options, and only beta has a gradient.
        """
        with torch.no_grad():
            values = self.critic(reached)
            worse = take_column(values, option) - mix_values(self.compute_fresh_choice(reached), values, option)
        return (take_column(self.compute_betas(reached), option) * (worse + margin) * goes_on).mean()

    def compute_old_log_probability(self, rollout: Rollout, choices: OptionChoices) -> Tensor:
        """Return the log probability of each action at its choice, (n,); call it before the first update."""
        if choices.log_probability is not None:
            return rollout.log_probability
        return take_column(self.compute_log_policies(rollout.observation, choices.option, rollout.mask),
                           rollout.action)

    def compute_option_loss(self, observation: Tensor, mask: Tensor, option: Tensor, action: Tensor,
                            old_log_probability: Tensor, advantage: Tensor, target: Tensor) -> dict[str, Tensor]:
        """Return PPO's loss of actions within options over a minibatch, and its parts.

        Observations are encoded, (n, ...), the mask is bool (n, actions), all others are (n,); the target is for
        Q(s, o).
        """
        log_policy = self.compute_log_policies(observation, option, mask)
        values = take_column(self.critic(observation), option)
        return compute_clipped_parts(take_column(log_policy, action), compute_entropy(log_policy, mask), values,
                                     old_log_probability, advantage, target, self.settings)


# --- agents -------------------------------------------------------------------------------


class OptionRolloutAgent(BatchAgent, OptionAgent):
    """Base of agents that learn options with networks from rollouts, with `rollout_per_env` among the settings.

    Options and rows are NumPy arrays with one environment, and in `OptionRollout` and `OpenOptions` with many.
    """

    Heads: ClassVar[type[OptionHeads]] = OptionHeads
    trained: ClassVar[tuple[str, ...]] = ()
    """Networks with the step size `learning_rate`; empty for all."""
    settings: Any
    is_markov: bool = False
    STATE = (Kept("_kept_rollout", "rollout", unpack=dict), Kept("_kept_choices", "choices", unpack=dict), "log",
             Kept("_kept_option", "option"), "_action_rng", "_option_rng", "_batch_rng",
             Kept("heads.learner", "learner"), Kept("_many_rng", is_left_out=True),
             Kept("_many_option_rng", is_left_out=True))

    def __init__(self, observation_space: gymnasium.Space, action_space: gymnasium.Space, seed: int,
                 settings: Any = None) -> None:
        self.settings = settings = settings or self.Settings()
        super().__init__(settings.options, self.name)
        self._encoder = ObservationEncoder(observation_space, settings.scale_observations)
        self._actions = count_actions(action_space, self.name)
        self.heads = self.Heads(self.name, self._encoder, self._actions, seed, settings, self.trained)
        self._action_rng, self._option_rng = make_rng(seed, "actions"), make_rng(seed, "options")
        self._batch_rng = make_rng(seed, "batches")
        self._many_rng, self._many_option_rng = make_rng(seed, "streams"), make_rng(seed, "streams' options")
        self._former, self._is_chosen = NONE, True
        self._many: tuple[OptionRollout, OpenOptions] | None = None  # None in one environment
        self._forget()

    def _forget(self) -> None:
        self._rows: list[tuple] = []
        self._choices: list[tuple[int, int, bool]] = []

    def compute_policies(self, observation: Any, action_mask: NDArray[np.bool_]) -> NDArray[np.float64]:
        """pi_o(a | s) over legal actions, float64 (options, actions)."""
        return self.heads.compute_policies(observation, action_mask)

    def compute_terminations(self, observation: Any) -> NDArray[np.float64]:
        """Probability that each option ends at the observation, beta_o(s), float64 (options,)."""
        return self.heads.compute_terminations(observation)

    def compute_preferences(self, observation: Any) -> NDArray:
        """Return the logits of the most probable option's policy at an observation, unmasked, (actions,)."""
        option = int(self.heads.compute_option_policy(observation).argmax())
        return self.heads.compute("policy", observation).reshape(self.options, -1)[option]

    def compute_state_value(self, observation: Any) -> float:
        """Return the mean of Q(s, o) over the policy over options, in units of return."""
        return float(self.heads.compute_option_policy(observation) @ self.heads.compute_option_values(observation))

    # --- acting -------------------------------------------------------------------------

    def begin_episodes(self, num_envs: int = 1, device: torch.device | None = None) -> None:
        """Begin an episode in every environment; with as many as before, the rollout is truncated and continues."""
        self._option, self._decisions = NONE, 0
        if self.place == (num_envs, device):
            if self._many is not None:
                self._many[0].truncate()
                self._many[1].begin_episodes()
            elif self._rows:
                self._rows[-1] = (*self._rows[-1][:OVER], True, *self._rows[-1][OVER + 1:])
            return
        self.place = num_envs, device
        self.move(device or torch.device("cpu"))
        self._forget()
        self._many = None if device is None else (OptionRollout(num_envs, device, self._many_rng),
                                                  OpenOptions(num_envs, device, self._many_option_rng))

    def act(self, batch: Moments) -> Any:  # pyright: ignore[reportIncompatibleMethodOverride] - as in `BatchAgent`
        """Sample actions from the running options' policies, int64 (n,); a new episode first samples an option."""
        if self._many is None:
            return np.array((self._act_one(batch.observation[0], batch.action_mask[0]),))
        seen = self._encoder.encode_many(batch.observation)
        rollout, options = self._many
        with torch.no_grad():
            option = options.draw(batch.env, self.heads.compute_betas(seen), self.heads.compute_fresh_choice(seen))
            log_policy = self.heads.compute_log_policies(seen, option, batch.action_mask)
        action = draw_rows(log_policy.exp(), rollout.generator)
        rollout.note_choice(batch.env, take_column(log_policy, action))
        return action

    def _act_one(self, observation: Any, action_mask: NDArray[np.bool_]) -> int:
        if self._option == NONE:
            self._choose(observation)
        self._shown = self._option, self._decisions, observation
        return sample_index(self.compute_policies(observation, action_mask)[self._option], self._action_rng)

    def _choose(self, observation: Any) -> None:
        self._former, self._is_chosen = self._option, True
        self._option, self._decisions = sample_index(self.heads.compute_option_policy(observation), self._option_rng), 0

    def act_greedy(self, observation: Any, action_mask: NDArray[np.bool_], rng: np.random.Generator) -> int:
        """Return the most probable action of the most probable option, given the former one in `rng`'s evaluation."""
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

    def make_policy(self) -> Policy:
        """Make a policy that chooses as `act_greedy` does."""
        return AgentPolicy(self)

    # --- learning -----------------------------------------------------------------------

    def observe(  # pyright: ignore[reportIncompatibleMethodOverride] - as in `BatchAgent`
            self, batch: Decisions) -> Mapping[str, float]:
        """Store the decisions; update when the rollout is full."""
        if self._many is None:
            return self._observe_one(read_decision(batch))
        rollout, options = self._many
        over = batch.terminated | batch.truncated
        rollout.add(batch, options.end(batch.env, over), self._encoder, self.settings)
        if len(rollout) < max(self.settings.rollout, self.settings.rollout_per_env * self.place[0]):
            return {}
        taken = rollout.take()
        options.report(self.log)
        return dict(self._learn(*taken)) | self.log.measure()

    def _observe_one(self, transition: SMDPTransition) -> Mapping[str, float]:
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
        """Sample the termination of the option, and the next option."""
        if over:
            self.log.add(self._option, self._decisions)
            self._option, self._decisions = NONE, 0
        elif self._option_rng.random() < self.compute_terminations(observation)[self._option]:
            self.log.add(self._option, self._decisions)
            self._choose(observation)
        else:
            self._former, self._is_chosen = self._option, False

    def _gather(self) -> tuple[Rollout, OptionChoices]:
        """Return the collected decisions of one environment."""
        return stack_decisions(self._rows, 0), OptionChoices(*map(torch.tensor, zip(*self._choices, strict=True)))

    def _draw_batches(self, units: int, collected: int) -> Iterator[Tensor]:
        """Yield as many minibatches as for `rollout` decisions, without single rows, which have no deviation."""
        size = self.settings.batch_size
        size = max(size, collected * size // self.settings.rollout)
        batches = draw_minibatches(self._batch_rng, units, size, self.settings.epochs)
        return (rows.to(self.heads.policy.weights.device) for rows in batches if len(rows) > 1)

    @abstractmethod
    def _learn(self, rollout: Rollout, choices: OptionChoices) -> Mapping[str, float]:
        """Make the updates from a rollout, before any other change of the networks; return numbers to log."""

    def move(self, device: torch.device) -> None:
        """Move networks and optimisers to a device."""
        self.heads.learner.move(device)

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
    def _kept_option(self) -> list[int]:
        """Running option, former option, whether it was chosen, and its number of decisions."""
        return [self._option, self._former, int(self._is_chosen), self._decisions]

    @_kept_option.setter
    def _kept_option(self, saved: list[int]) -> None:
        self._option, self._former, is_chosen, self._decisions = map(int, saved)
        self._is_chosen = bool(is_chosen)

    def load_state_dict(self, state: StateTree) -> None:
        """Restore the result of `state_dict`."""
        self._forget()
        super().load_state_dict(state)

    def state_dict(self) -> StateTree:
        """Return the state in `STATE`, after logging finished runs of options."""
        if self._many is not None:
            self._many[1].report(self.log)
        return super().state_dict()

    def list_running(self) -> dict[str, Stateful]:
        """Return parts of the state for many environments, by their names in a checkpoint."""
        return {} if self._many is None else dict(zip(("rollout", "options"), self._many, strict=True))
