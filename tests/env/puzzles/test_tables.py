"""Tables of puzzles: a stranger's rules, written once for one room, hold in a batch of several of their puzzles."""

import dataclasses

import numpy as np
import pytest
import torch

from hrl_escape.env.batched.engine import TensorRoom
from hrl_escape.env.batched.puzzles import base as table_module
from hrl_escape.env.batched.puzzles.base import TabulatedPuzzle, TensorContacts, get_tensor_puzzle, tabulate
from hrl_escape.env.batched.rooms import Rooms
from hrl_escape.env.instance import SpaceLayout
from hrl_escape.env.kinematics import Rules
from hrl_escape.env.observations.base import make_observer
from hrl_escape.env.presets import get_preset
from hrl_escape.env.puzzles.base import USE, Contacts, Puzzle
from hrl_escape.env.puzzles.hanoi import HanoiConfig
from hrl_escape.env.puzzles.mixins import Barring
from hrl_escape.env.sampling.generation import generate
from hrl_escape.errors import StateError, UnsupportedError
from hrl_escape.settings import Between

# --- a stranger's puzzle with all that a table may hold: presses, grips, chance, rewards, failure, doors ---


@dataclasses.dataclass(frozen=True)
class Kegs(Barring, Puzzle):
    """States (levels, keg in the hand): a press draws from a keg, `use` refills one, unless that spills."""

    kind = "kegs"
    count: int = 3
    depth: int = 3
    steadiness: float = 0.8
    target_names = property(lambda self: tuple(f"keg-{i + 1}" for i in range(self.count)))
    bounds = property(lambda self: ((0.0, float(self.depth)),) * self.count + ((0.0, 1.0),))
    chances = property(lambda self: (self.steadiness / 2, *([self.steadiness] if self.steadiness < 1.0 else [])))

    def make_state(self):
        return (0,) * self.count, None

    def list_starts(self):
        return self.make_state(), ((1,) * self.count, None)

    def update(self, state, contacts):
        levels, held = state
        for keg in contacts.pressed:
            drawn = 1 + (contacts.uniform < self.steadiness / 2)
            levels = (*levels[:keg], min(levels[keg] + drawn, self.depth), *levels[keg + 1:])
        if contacts.grip == 1 and held is None:
            held = next((keg for keg in contacts.touching if levels[keg] == self.depth), None)
        elif contacts.grip == -1 and held in contacts.touching:
            held = None
        elif contacts.grip == USE and contacts.touching and contacts.uniform >= self.steadiness:
            held = "spilled"
        return levels, held

    def compute_reward(self, before, after, contacts):
        return 0.5 * (sum(after[0]) - sum(before[0])) - 7.25 * (after[1] == "spilled" != before[1])

    def is_solved(self, state):
        return state[1] == self.count - 1

    def is_failed(self, state):
        return state[1] == "spilled"

    def get_shut(self, state):
        return sum((level < self.depth) << keg for keg, level in enumerate(state[0]))

    def observe(self, state):
        return (*map(float, state[0]), float(state[1] is not None))

    def get_lit(self, state):
        return tuple(level > 0 for level in state[0])


def draw_contacts(rng, targets, *, at_once):
    """A primitive that presses, or grips, releases or uses, what it touches; most touch one thing or nothing."""
    touched = tuple(np.flatnonzero(rng.random(targets) < at_once / targets).tolist())
    grip = int(rng.choice((0, 0, 0, 1, -1, USE)))
    return Contacts(() if grip else touched, uniform=float(rng.random()), touching=touched, grip=grip)


@pytest.mark.nightly
def test_a_strangers_puzzles_do_in_one_batch_what_they_do_alone():
    kegs = [Kegs(), Kegs(2, 4, 0.5), Kegs(3, 2, 1.0), Kegs(1, 1, 0.9), Kegs()]
    form, targets, rng = get_tensor_puzzle("kegs"), 3, np.random.default_rng(0)
    frame = SpaceLayout(target_names=Kegs().target_names, bounds=((0.0, 4.0),) * 3 + ((0.0, 1.0),))
    tables = {name: torch.from_numpy(table) for name, table in form.make_tables(kegs, frame).items()}
    copies = 20
    puzzles = kegs * copies
    columns = {name: table if name in form.whole else table.repeat(*(1,) * (table.dim() - 1), copies)
               for name, table in tables.items()}
    states = [puzzle.make_state() for puzzle in puzzles]
    seen = {"solved": 0, "failed": 0, "earned": 0, "several": 0}
    for _ in range(1000):  # 100,000 updates
        words = torch.tensor([form.encode(*pair) for pair in zip(puzzles, states, strict=True)])
        assert [form.decode(puzzle, word) for puzzle, word in zip(puzzles, words.tolist(), strict=True)] == states
        contacts = [draw_contacts(rng, puzzle.count, at_once=1.0) for puzzle in puzzles]
        after = [puzzle.update(*pair) for puzzle, *pair in zip(puzzles, states, contacts, strict=True)]
        moved = form.update(columns, words, pack(contacts), targets)
        assert moved.tolist() == [form.encode(*pair) for pair in zip(puzzles, after, strict=True)]
        earned = [p.compute_reward(*rest) for p, *rest in zip(puzzles, states, after, contacts, strict=True)]
        assert form.compute_reward(columns, words, moved, pack(contacts), targets).tolist() == earned
        both = list(zip(puzzles, after, strict=True))
        assert form.is_solved(columns, moved).tolist() == [puzzle.is_solved(state) for puzzle, state in both]
        assert form.is_failed(columns, moved).tolist() == [puzzle.is_failed(state) for puzzle, state in both]
        assert form.get_lit(columns, moved).tolist() == [
            sum(on << i for i, on in enumerate(puzzle.get_lit(state))) for puzzle, state in both]
        shut = form.find_shut(columns, moved, 3).to(torch.int64)
        assert (shut * torch.tensor([[1], [2], [4]])).sum(0).tolist() == [p.get_shut(state) for p, state in both]
        numbers = form.observe(columns, moved, targets).T.tolist()
        assert numbers == [[*p.observe(state), *[0.0] * (4 - len(p.bounds))] for p, state in both]
        for name, count in (("solved", sum(p.is_solved(s) for p, s in both)), ("earned", np.count_nonzero(earned)),
                            ("failed", sum(p.is_failed(s) for p, s in both)),
                            ("several", sum(len(c.touching) > 1 for c in contacts))):
            seen[name] += count
        states = [p.list_starts()[1] if p.is_failed(s) or rng.random() < 0.02 else s for p, s in both]
    assert min(seen.values()) > 500, seen


def pack(contacts):
    """Contacts of rooms as tensors."""
    bits = [torch.tensor([sum(1 << target for target in getattr(one, name)) for one in contacts])
            for name in ("pressed", "touching")]
    grip, none = torch.tensor([one.grip for one in contacts]), torch.zeros(len(contacts), dtype=torch.int64)
    chance = torch.tensor([one.uniform for one in contacts], dtype=torch.float64)
    return TensorContacts(bits[0], chance, bits[1], grip, none != 0, chance, chance, none - 1, none - 1)


def test_a_batch_of_codes_of_several_lengths_shows_as_many_numbers_as_one_room():
    config = get_preset("code-lock")
    config = dataclasses.replace(config, puzzle=dataclasses.replace(config.puzzle, length=Between(2, 6)))
    rooms = [generate(config, seed) for seed in range(8)]
    room = next(room for room in rooms if len(room.puzzle.code) < 6)
    batch, alone = TensorRoom(Rooms(2, instance=[room] * 2, observation="state")), make_observer("state", Rules(room))
    batch.reset(torch.arange(2))
    seen = alone.observe(batch.get_room_state(0))
    assert batch.observe()[0].numpy() == pytest.approx(seen)


def test_every_kind_without_a_form_of_its_own_has_that_of_all():
    assert all(isinstance(get_tensor_puzzle(kind), TabulatedPuzzle) for kind in ("hanoi", "code-lock", "kegs"))
    assert not isinstance(get_tensor_puzzle("buttons"), TabulatedPuzzle)


def test_a_state_to_which_nothing_leads_is_not_put_into_a_batch():
    config = get_preset("hanoi")
    room = TensorRoom(Rooms(instance=generate(dataclasses.replace(config, puzzle=HanoiConfig(discs=4)), 0)))
    room.reset(torch.tensor([0]))
    puzzle, state = room.instances[0].puzzle, room.get_room_state(0)
    lifted = state._replace(puzzle=puzzle.encode((0, 0, 1, 3)))
    room.set_room_state(0, lifted)
    assert room.get_room_state(0) == lifted
    stuck = puzzle.encode((0, 1, 2, 3))  # no peg had the fourth disc on top, nor takes it
    assert puzzle.is_state(stuck)
    with pytest.raises(StateError, match="is unreachable by presses and grips"):
        room.set_room_state(0, state._replace(puzzle=stuck))


# --- rules of which no table can be made ---


@dataclasses.dataclass(frozen=True)
class Lamp(Puzzle):
    """Two switches; subclasses spoil it."""

    kind, target_names, bounds = "lamp", ("a", "b"), ((0.0, 9.0),)

    def make_state(self):
        return 0

    def update(self, state, contacts):
        return (state + len(contacts.pressed)) % 3

    def is_solved(self, state):
        return state == 2

    def observe(self, state):
        return (float(state),)

    def get_lit(self, state):
        return (state > 0,) * 2


class Watching(Lamp):
    is_watching = True


class Placed(Lamp):
    def update(self, state, contacts):
        return state if contacts.x > 3.0 else super().update(state, contacts)


class Led(Lamp):
    def update(self, state, contacts):
        return state if contacts.ahead == 2 else super().update(state, contacts)


class Reversed(Lamp):
    def update(self, state, contacts):
        for target in reversed(contacts.pressed):
            state = 2 if target == 0 else state // 2
        return state


class Paired(Lamp):
    def compute_reward(self, before, after, contacts):
        return float(len(contacts.pressed) == 2)


class Fickle(Lamp):
    is_random = True


class Endless(Lamp):
    def update(self, state, contacts):
        return state + len(contacts.pressed)


@pytest.mark.parametrize(("lamp", "why"), [
    (Watching(), "they watch every primitive"), (Placed(), "they read contacts.x"), (Led(), "they read contacts.ahead"),
    (Reversed(), "a and b at once have another effect in the state"), (Paired(), "a and b at once have another effect"),
    (Fickle(), "they read contacts.uniform and list no chances"), (Endless(), "they have more than 1,000 states")])
def test_rules_that_a_table_would_get_wrong_are_refused_with_the_reason(lamp, why, monkeypatch):
    monkeypatch.setattr(table_module, "MOST_TABULATED", 1000)
    with pytest.raises(UnsupportedError, match=f"'lamp' has no tensor form.*{why}.*register_tensor_puzzle"):
        tabulate(lamp)
    assert len(tabulate(Lamp()).states) == 3
