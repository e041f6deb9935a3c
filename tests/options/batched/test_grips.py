"""Batched options that grip and release, room by room beside `OptionsEnv`, and state by state beside the planner."""

import dataclasses
import itertools

import pytest
import torch

from hrl_escape.env.batched.puzzles.base import get_tensor_puzzle, tabulate
from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.env.presets import get_preset
from hrl_escape.env.puzzles.base import Contacts, puzzles, register_puzzle
from hrl_escape.env.puzzles.buttons import ButtonsConfig, ButtonsPuzzle
from hrl_escape.env.puzzles.taxi import Ride
from hrl_escape.env.sampling.generation import generate
from hrl_escape.errors import UnsupportedError
from hrl_escape.options.batched.aims import NO_STATE, check_goals, find_possible, make_aims
from hrl_escape.options.batched.env import ENDINGS, BatchedOptionsEnv
from hrl_escape.options.degraded import OptionDegradation
from hrl_escape.options.options_env import OptionsEnv
from hrl_escape.planning.goals import ExitGoal, GripGoal, is_reached, make_goal
from hrl_escape.planning.planner import get_planner
from hrl_escape.sets.benchmark import load_benchmark
from tests.options.batched.test_batched_kinds import replay

ROOMS = {
    "taxi": lambda: [generate(get_preset("taxi"), 0)],
    "foraging": lambda: [generate(get_preset("foraging"), 0)],
    "towers": lambda: [generate(get_preset("blocks-world"), seed) for seed in range(2)],
    "towers by hand": lambda: [generate(get_preset("blocks-world", hand=True), 0)],
    "two and three blocks": lambda: [load_benchmark("ladder-1")["freight"].train[place] for place in range(4)],
}


@dataclasses.dataclass(frozen=True)
class GrippedConfig(ButtonsConfig):
    """Buttons of which every second one is gripped instead of pressed."""

    kind = "gripped-buttons"

    def make_puzzle(self, rng):
        puzzle = super().make_puzzle(rng)
        return GrippedButtons(**{field.name: getattr(puzzle, field.name) for field in dataclasses.fields(puzzle)})


@dataclasses.dataclass(frozen=True)
class GrippedButtons(ButtonsPuzzle):
    """The rules of buttons, where a grip on one of them counts as its press."""

    kind = "gripped-buttons"

    def update(self, state, contacts):
        if contacts.grip > 0:  # the first of those touched at which it does anything
            after = (super(GrippedButtons, self).update(state, Contacts((target,)))
                     for target in contacts.touching if target % 2)
            return next((other for other in after if other != state), state)
        return super().update(state, Contacts(tuple(target for target in contacts.pressed if target % 2 == 0)))

    def make_symbolic_model(self):
        model = super().make_symbolic_model()
        return dataclasses.replace(model, operators=tuple(
            dataclasses.replace(op, action="grip") if number % 2 else op for number, op in enumerate(model.operators)))


def is_grip(goal):
    return isinstance(goal, GripGoal)


@pytest.mark.nightly_for(
    "whole-towers", "whole-towers by hand", "with ancestors-towers", "with ancestors-towers by hand",
    "with ancestors-two and three blocks", "worse-taxi", "worse-foraging", "worse-towers", "worse-towers by hand",
    "worse-two and three blocks", "interrupted-towers", "interrupted-towers by hand",
    "interrupted-two and three blocks", "whole-taxi", "with ancestors-taxi", "with ancestors-foraging",
    "interrupted-taxi", "interrupted-foraging", "whole-two and three blocks")
@pytest.mark.parametrize("name", ROOMS)
@pytest.mark.parametrize("arguments", [
    {}, {"option_set": "press-with-ancestors"}, {"options": OptionDegradation(detour=3, missing=0.3, seed=1)},
    {"interruptible": True, "max_duration": 6, "options": OptionDegradation(failure=0.2, early_stop=0.1, seed=2)},
], ids=["whole", "with ancestors", "worse", "interrupted"])
@pytest.mark.nightly_for("whole-foraging")
def test_each_room_does_what_options_env_does(name, arguments):
    rooms, arguments = ROOMS[name](), {**arguments, "include_primitives": False, "discount": 0.9}
    env = BatchedOptionsEnv(4 * len(rooms), instance=rooms, **arguments)
    made = replay(env, 40 if "interruptible" in arguments else 10)
    singles = [OptionsEnv(EscapeRoomEnv(instance=room), **arguments) for room in env.room.instances]
    acted, planned, taken, lasts = 0, 0, 0, dict[int, int]()
    for number, state, mask, done in sorted(made, key=lambda one: one[0]):
        single = singles[number % len(rooms)]
        assert (single.action_names, single.action_space.about) == (env.action_names, env.action_space.about)
        if number not in lasts:
            single.reset(seed=number)
        if lasts.get(number, -1) != int(done.action):  # not one that was interrupted and goes on
            single.unwrapped.set_state(state)
            single.resume()
        exit_or_not = slice(None, -1 if "interruptible" in arguments else None)  # greed and plan may cross it apart
        assert single.action_masks().tolist()[exit_or_not] == mask[exit_or_not]
        _, reward, terminated, truncated, info = single.step(int(done.action))
        assert (ENDINGS[done.ended], bool(done.terminated), bool(done.truncated)) == (
            info["option"]["ended"], terminated, truncated)
        lasts[number] = int(done.action) if info["option"]["ended"] == "interrupted" else -1
        k, extra = int(done.duration), int(done.duration) - info["duration"]
        assert float(done.reward) == pytest.approx(reward - extra, abs=1e-4)
        assert float(done.discount) == pytest.approx(0.9**k, rel=1e-5)
        planned, taken = planned + info["duration"], taken + k
        is_act = is_grip(check_goals(single.unwrapped.instance)[int(done.action)])
        acted += is_act and info["option"]["ended"] == "reached"
    assert acted > 3, "things were gripped and released"
    assert abs(taken - planned) <= (0.08 if "hand" in name else 0.05 if "option_set" in arguments else 0.01) * planned


@pytest.mark.nightly
@pytest.mark.parametrize("option_set", ["press", "press-with-ancestors"])
def test_what_is_gripped_behind_shut_doors_waits_for_its_ancestors(option_set, request):
    """A puzzle with presses, grips and doors between rooms, which is none of the package's."""
    register_puzzle(GrippedConfig, GrippedButtons)
    request.addfinalizer(lambda: puzzles.unregister(GrippedConfig.kind))
    config = get_preset("inner-doors")
    puzzle = GrippedConfig(**{field.name: getattr(config.puzzle, field.name)
                              for field in dataclasses.fields(config.puzzle)})
    config = dataclasses.replace(config, puzzle=puzzle, robot=dataclasses.replace(config.robot, gripper=True))
    room, arguments = generate(config, 1), {"option_set": option_set, "include_primitives": False}
    env = BatchedOptionsEnv(3, instance=room, **arguments)
    single, masks = OptionsEnv(EscapeRoomEnv(instance=room), **arguments), []
    for number, state, mask, done in replay(env, 10):
        single.reset(seed=number)
        single.unwrapped.set_state(state)
        single.resume()
        assert single.action_masks().tolist() == mask
        info = single.step(int(done.action))[4]
        assert ENDINGS[done.ended] == info["option"]["ended"]
        masks.append([can for can, goal in zip(mask, check_goals(room), strict=True) if is_grip(goal)])
    assert any(map(any, masks)) == (option_set == "press-with-ancestors"), "ten choices at random open no such way"


@pytest.mark.parametrize("name", ROOMS)
def test_acts_are_possible_and_done_where_the_planner_says_so(name):
    """Every state of every puzzle beside `can_start` and `is_reached` in a real room."""
    rooms = ROOMS[name]()
    aims, counted = make_aims(rooms, torch.device("cpu")), 0
    for column, room in enumerate(rooms):
        planner, puzzle, form = get_planner(room), room.puzzle, get_tensor_puzzle(room.puzzle.kind)
        env = EscapeRoomEnv(instance=room)
        env.reset(seed=0)
        kind, words = int(aims.kinds[column]), aims.words.tolist()
        for state, (number, goal) in itertools.product(tabulate(puzzle, pairs=False).states,
                                                       enumerate(check_goals(room))):
            place, here = words.index(form.encode(puzzle, state)), env.get_state()._replace(puzzle=state)
            if not is_grip(goal) or goal.target >= len(room.targets):
                assert bool(aims.can[number, kind, place]) == (not is_grip(goal))
                continue
            assert bool(aims.can[number, kind, place]) == planner.routes.can_start(here, goal)
            for outcome, chance in enumerate((0.0, *puzzle.chances)):
                sign = 1 if goal.action == "grip" else -1
                contacts = Contacts((), uniform=chance, touching=(goal.target,), grip=sign)
                then, word = puzzle.update(here.puzzle, contacts), int(aims.after[outcome, number, kind, place])
                assert (word != NO_STATE) == is_reached(goal, here, here._replace(puzzle=then), planner.rules)
                assert word == NO_STATE or form.decode(puzzle, word) == then
                counted += word != NO_STATE
        env.close()
    assert counted >= 12
    assert len(aims.can[0]) == len({len(room.targets) for room in rooms}), "towers of as many blocks share a table"


@pytest.mark.nightly_for("towers by hand-False", "foraging-False", "towers-False", "two and three blocks-False")
@pytest.mark.parametrize("compiled", [False, pytest.param(True, marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", ROOMS)
def test_the_planners_order_of_grips_and_releases_escapes(name, compiled):
    """Each room is told the options of its plan, one after the other."""
    rooms = ROOMS[name]()
    env = BatchedOptionsEnv(3 * len(rooms), instance=rooms, include_primitives=False, compile=compiled)
    env.reset(torch.arange(env.count) + 5)
    goals, has_escaped = [check_goals(room) for room in env.room.instances], torch.zeros(env.count, dtype=torch.bool)
    choice = torch.full((env.count,), -1)
    for _ in range(400):
        for room in (env.is_waiting & ~has_escaped).nonzero().squeeze(1).tolist():
            number = int(env.room.state.instance[room])
            planner, state = get_planner(env.room.instances[number]), env.room.get_room_state(room)
            goal = ExitGoal() if planner.rules.instance.puzzle.is_solved(state.puzzle) else make_goal(
                planner.rules.instance.symbolic_model.find_fewest(
                    planner.rules.instance.puzzle.symbolic.get_facts(state.puzzle))[0], planner.rules.instance)
            choice[room] = goals[number].index(goal)
        done = env.step(choice)
        assert (done.ended[done.where & ~has_escaped] <= ENDINGS.index("episode-over")).all()
        has_escaped |= done.where & done.success
        choice[done.where] = -1
        if has_escaped.all():
            break
    assert has_escaped.all()


@pytest.mark.nightly
def test_a_slip_while_gripping_is_gripped_again():
    config = get_preset("taxi")
    room = generate(dataclasses.replace(config, dynamics=dataclasses.replace(config.dynamics, slip=0.5)), 0)
    env = BatchedOptionsEnv(32, instance=room, include_primitives=False)
    env.reset(torch.arange(32))
    generator, acts = torch.Generator().manual_seed(0), torch.tensor([is_grip(goal) for goal in check_goals(room)])
    begun, made = env.room.state.puzzle.clone(), 0
    for _ in range(300):
        wanted = env.action_mask.float() * (1 + 9 * acts)
        done = env.step(torch.multinomial(wanted, 1, generator=generator)[:, 0])
        assert not (done.where & (done.ended == ENDINGS.index("planning-failed"))).any()
        is_act = done.where & (done.ended == ENDINGS.index("reached")) & acts[done.action]
        assert (env.room.state.puzzle != begun)[is_act & ~done.truncated].all(), "only then is it done"
        made += int(is_act.sum())
        begun = torch.where(done.where, env.room.state.puzzle, begun)
    assert made > 100


@pytest.mark.nightly_for("config1-more than 20,000 states")
@pytest.mark.parametrize(("config", "message"), [
    (get_preset("taxi", fickle=True), "they watch every primitive"),
    (get_preset("blocks-world", count=12), "more than 20,000 states"),
])
def test_rooms_whose_acts_cannot_be_tried_are_refused(config, message):
    with pytest.raises(UnsupportedError, match=f"use OptionsEnv over one room.*{message}"):
        BatchedOptionsEnv(2, config)


def test_in_a_state_that_no_ride_leads_to_nothing_can_be_gripped():
    """`OptionsEnv` knows such states; a batch, whose table does not hold them, presses and leaves there."""
    room = generate(get_preset("taxi"), 0)
    env = BatchedOptionsEnv(1, instance=room, include_primitives=False)
    env.reset(torch.tensor([0]))
    state = env.room.get_room_state(0)
    goals = check_goals(room)
    for ride in (Ride(2, 2), Ride(0, 1, settled=True)):
        env.room.set_room_state(0, state._replace(puzzle=room.puzzle.encode(ride)))
        possible = find_possible(env.room.layout, make_aims([room], env.device), env.room.state)[0]
        assert possible.tolist() == [not is_grip(goal) for goal in goals]


def test_a_batch_has_no_pushes():
    with pytest.raises(UnsupportedError, match="push nothing.*OptionsEnv"):
        check_goals(generate(get_preset("push-block"), 0))
