"""The option keyboard: skills are keys, and chords of wanted and unwanted events are played without learning them.

Barreto et al. (2019), in tables: successor features of the skills (Barreto et al. 2017), generalised policy improvement
for chords, and a player that learns to choose chords. Events are goals that become reached, such as a touch.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import gymnasium
import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.agent import AgentSettings, count_actions
from hrl_escape.agents.components.tables import QTable, make_cell_finder
from hrl_escape.agents.hierarchy.goal_space import GoalSpace, GoalTask, make_goal_space
from hrl_escape.agents.hierarchy.runner import TabularRunner
from hrl_escape.agents.hierarchy.task import Frame, Hierarchy, Return, Seen, Stack, Step
from hrl_escape.agents.state import Columns, Stateful
from hrl_escape.settings import Range


@dataclass(frozen=True, kw_only=True)
class OptionKeyboardSettings(AgentSettings):
    """Settings of `option-keyboard`; exploration applies to the player, and `chord_epsilon` within a chord."""

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
    bins: Annotated[int, Range(2)] = 11
    """Number of evenly spaced points, both bounds included, to round bounded components to: 11 over a 20 m room is 2 m.
    More points make more, finer states. Binary components are unchanged."""
    resolution: Annotated[float, Range(0, open_low=True)] = 1.0
    """Unit to round unbounded components to multiples of. Smaller values make more, finer states."""
    learning_rate: Annotated[float, Range(0, 1, open_low=True)] = 0.5
    """Step size of the first update of a state and action. 1 suits deterministic environments; smaller values average
    noise."""
    learning_rate_power: Annotated[float, Range(0, 1)] = 0.0
    """Power p in the step size learning_rate / n^p of the n-th update of a state and action. Values above 0.5 converge
    under noise."""
    initial_value: float = 0.0
    """Value of actions that were never tried, in units of return. Higher values explore more."""
    gamma: Annotated[float, Range(0, 1)] = 0.99
    """Discount per primitive: a reward k primitives later counts gamma^k. Higher values look further ahead."""
    polled: Literal["never", "evaluation", "always"] = "never"
    """Choose every running call again at each primitive, instead of running it to its end: never, in evaluation
    only (hierarchical greedy execution), or always."""
    patience: Annotated[int, Range(1)] = 50
    """Most primitives of a chord without an event."""
    chord_epsilon: Annotated[float, Range(0, 1)] = 0.1
    """Probability of a random primitive within a chord. More explores more."""


class SuccessorTable(Stateful):
    """psi_i(s, a), the discounted probability that each event is the first to happen, under the skill of event i."""

    STATE = (Columns({"values": "_values"}),)

    def __init__(self, events: int, actions: int, settings: Any) -> None:
        self._shape, self._rate = (events, actions, events), settings.learning_rate
        self._values: dict[bytes, NDArray[np.float64]] = {}

    def get(self, key: bytes) -> NDArray[np.float64]:
        """Return psi(s), (skills, actions, events), read-only."""
        values = self._values.get(key)
        return np.zeros(self._shape) if values is None else values

    def compute_chord(self, key: bytes, chord: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return values by generalised policy improvement: max over skills i of psi_i(s, .) w, (actions,)."""
        return (self.get(key) @ chord).max(axis=0)

    def update(self, key: bytes, action: int, happened: NDArray[np.floating], discount: float, after: bytes,
               legal: NDArray[np.bool_]) -> None:
        """Update every skill's psi_i(s, a) towards the events + discount psi_i(s', a'), a' best for event i.

        `happened` at s', (events,), has the discount of its event, and 0 for all others. The discount is gamma^k, 0 if
        an event happened or the episode terminated; primitives are `legal` at s'.
        """
        target = np.tile(happened, (self._shape[0], 1))
        if discount:
            follow, skills = self.get(after), np.arange(self._shape[0])
            best = np.where(legal, follow[skills, :, skills], -np.inf).argmax(axis=1)
            target = target + discount * follow[skills, best]
        values = self._values.setdefault(key, np.zeros(self._shape))
        values[:, action] = (1 - self._rate) * values[:, action] + self._rate * target


class _Player(GoalTask):
    """Chooses a chord; its reward is the environment's."""

    def legal(self, seen: Seen, context: Any) -> NDArray[np.bool_]:
        return np.ones(int(self.space.n), np.bool_)


class _Chord(GoalTask):
    """Plays a chord until an event, or until patience runs out."""

    def __init__(self, space: GoalSpace, chords: int, primitives: int, patience: int) -> None:
        super().__init__("chord", space, primitives)
        self._chords, self._patience = chords, patience

    def list_calls(self) -> Mapping[str, Any]:
        return {f"chord {number}": number for number in range(self._chords)}

    def ends(self, frame: Frame, seen: Seen) -> float:
        """Return 1 once a goal is reached that was not reached at the beginning, even if left and reached again."""
        before, now = (self.goal_space.list_reached(each.observation) for each in (frame.start, seen))
        return float(frame.primitives >= self._patience or bool((now & ~before).any()))


def make_chords(events: int) -> NDArray[np.float64]:
    """Return one chord per event; per event without the others; and one for all events, (chords, events)."""
    single = np.eye(events)
    return np.concatenate([single, 2 * single - 1, np.ones((1, events))] if events > 1 else [single])


class OptionKeyboard(TabularRunner):
    """Three kinds of learning from each primitive and each chord.

        skill i   psi_i(s, a) <- phi + gamma^k psi_i(s', argmax over a' of psi_i(s', a')[i]), up to the first event
        chord w   plays argmax over a of max over i of psi_i(s, a) w, without learning
        player    Q(s, w) <- R + gamma^k max over w' of Q(s', w')

    phi is 1 for the events that happen, discounted within an option of the environment. Every skill learns from every
    primitive. A chord is at least as good as each skill alone (Barreto et al. 2017, theorem 1).

    Args:
        goal_space: its goals are the events, each when it becomes reached; by default the result of `make_goal_space`.
    """

    Settings = OptionKeyboardSettings
    STATE = ("skills", "table")

    def __init__(self, observation_space: gymnasium.Space, action_space: gymnasium.Space, seed: int,
                 settings: OptionKeyboardSettings | None = None, goal_space: GoalSpace | None = None) -> None:
        settings = settings or OptionKeyboardSettings()
        actions = count_actions(action_space, "option-keyboard")
        self.space = space = goal_space or make_goal_space(observation_space, "option-keyboard")
        self.chords = make_chords(len(space.goals))
        self._chord = _Chord(space, len(self.chords), actions, settings.patience)
        player = _Player("player", space, len(self.chords), self._chord)
        super().__init__(Hierarchy(player, (self._chord,), source="learned", privileges=space.privileges), seed,
                         settings)
        self._find_cell = make_cell_finder(player.view_space or observation_space, settings, "option-keyboard")
        self.skills = SuccessorTable(len(space.goals), actions, settings)
        self.table = QTable(len(self.chords), settings)

    def make_key(self, view: Any) -> bytes:
        """Return the key of a view in the tables."""
        return self._find_cell(view).tobytes()

    def weigh(self, stack: Stack, view: Any, seen: Seen) -> NDArray[np.float64]:
        """Return values of chords, or of primitives within one."""
        frame = stack[-1]
        if frame.task is not self._chord:
            return self.table.get_values(self.make_key(view))
        return self.skills.compute_chord(self.make_key(view), self.chords[frame.context])

    def choose(self, stack: Stack, view: Any, legal: NDArray[np.bool_], seen: Seen) -> int:
        """Explore by the settings for the player, and by `chord_epsilon` for a chord."""
        if stack[-1].task is not self._chord:
            return super().choose(stack, view, legal, seen)
        if self._action_rng.random() < self.settings.chord_epsilon:
            return int(self._action_rng.choice(legal.nonzero()[0]))
        return self.choose_greedy(stack, view, legal, seen, self._action_rng)

    def learn(self, step: Step, returns: list[Return]) -> Mapping[str, float]:
        """Update every skill with the primitive, and the player with its finished chord."""
        before, after = (self.space.list_reached(each.observation) for each in (step.seen, step.next_seen))
        happened = after & ~before
        goes_on = not (happened.any() or step.terminated)
        view, next_view = (self._chord.view(each, ()) for each in (step.seen, step.next_seen))
        arrival = self.gamma ** (step.duration - 1)
        self.skills.update(self.make_key(view), step.action, arrival * happened,
                           arrival * self.gamma * goes_on, self.make_key(next_view), step.next_seen.mask)
        error = 0.0
        for returned in returns:
            if returned.frame.task is not self._chord:
                decision, target = returned.decision, returned.decision.reward
                if not returned.terminated:
                    target += decision.discount * float(self.table.get_values(self.make_key(next_view)).max())
                error = abs(self.table.update(self.make_key(decision.view), decision.choice, target))
        return self.finish_step(step, error)
