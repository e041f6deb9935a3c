"""Kinds of batched options room by room beside `OptionsEnv`: interrupted, with ancestors, limited, made worse."""

import dataclasses

import gymnasium
import numpy as np
import pytest
import torch

import hrl_escape  # noqa: F401  # registers the environments
from hrl_escape.env.config import RobotConfig, RoomConfig, ShapeConfig, StartConfig
from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.env.presets import get_preset
from hrl_escape.env.puzzles.base import Panels
from hrl_escape.env.puzzles.buttons import ButtonsConfig
from hrl_escape.env.puzzles.graphs import GraphConfig
from hrl_escape.env.sampling.generation import generate
from hrl_escape.errors import UnknownNameError, UnsupportedError
from hrl_escape.options.batched.env import ENDINGS, BatchedOptionsEnv
from hrl_escape.options.degraded import OptionDegradation
from hrl_escape.options.options_env import OptionsEnv

CHAIN = RoomConfig(name="chain", room=ShapeConfig(width=6, depth=6), robot=RobotConfig(body_radius=0.3),
                   puzzle=ButtonsConfig(count=3, graph=GraphConfig(kind="chain"), buttons=Panels(width=0.6)),
                   start=StartConfig(choices=5))
KINDS = {
    "whole": {},
    "limited": {"max_duration": 4},
    "with ancestors": {"option_set": "press-with-ancestors"},
    "with ancestors, limited": {"option_set": "press-with-ancestors", "max_duration": 9, "include_primitives": False},
    "failing": {"options": OptionDegradation(failure=0.4, seed=1)},
    "stopping": {"options": OptionDegradation(early_stop=0.2, seed=2)},
    "wasting": {"options": OptionDegradation(detour=3), "max_duration": 6},
    "missing": {"options": OptionDegradation(missing=0.6, seed=1)},
    "all missing": {"options": OptionDegradation(missing=1.0), "include_primitives": False},
    "ancestors failing": {"options": OptionDegradation(failure=0.3, detour=2, option_set="press-with-ancestors")},
    "interrupted": {"interruptible": True},
    "interrupted, limited": {"interruptible": True, "max_duration": 3, "include_primitives": False},
    "interrupted and worse": {"interruptible": True, "options": OptionDegradation(
        failure=0.2, early_stop=0.1, detour=2, option_set="press-with-ancestors")},
}


def replay(env, decisions, most=4_000):
    """Masked random decisions of every room: (room, state before, legal actions, whatever was handed over)."""
    env.reset(torch.arange(env.count))
    rng, made = np.random.default_rng(0), []
    begins = [env.room.get_room_state(room) for room in range(env.count)]
    masks, left = env.action_mask, np.full(env.count, decisions)
    last = torch.full((env.count,), -1)
    for _ in range(most):
        # interrupted options are mostly continued
        again = torch.from_numpy(rng.random(env.count) < 0.8) & (last >= 0)
        drawn = torch.tensor([rng.choice(np.flatnonzero(mask)) for mask in env.action_mask.numpy()])
        done = env.step(torch.where(again, last, drawn))
        goes_on = done.where & (done.ended == ENDINGS.index("interrupted"))
        last = torch.where(goes_on, done.action, torch.where(done.where, -1, last))
        for room in done.where.nonzero().squeeze(1).tolist():
            if left[room] > 0:
                made.append((room, begins[room], masks[room].tolist(), type(done)(*(field[room] for field in done))))
            left[room] -= 1
            begins[room] = env.room.get_room_state(room)
        masks = torch.where(done.where.unsqueeze(1), env.action_mask, masks)
        if (left <= 0).all():
            return made
    raise AssertionError("decisions do not end")


@pytest.mark.nightly_for(
    "whole", "with ancestors", "with ancestors, limited", "ancestors failing", "interrupted, limited",
    "interrupted and worse", "limited", "wasting")
@pytest.mark.parametrize("kind", KINDS)
def test_each_room_does_what_options_env_does(kind):
    """Every decision is made again from the state in which it began; an interrupted option is not begun again."""
    arguments = KINDS[kind]
    env = BatchedOptionsEnv(4, instance=generate(CHAIN, 0), discount=0.9, **arguments)
    made = replay(env, 40 if "interruptible" in arguments else 12)
    single = OptionsEnv(EscapeRoomEnv(instance=env.room.instances[0]), discount=0.9, **arguments)
    assert single.action_names == env.action_names
    endings, most_apart = set(), 2 if "ancestors" in str(arguments) else 0
    for room in range(env.count):
        single.reset(seed=room)
        resumes, last = True, -1
        for state, mask, done in (rest for where, *rest in made if where == room):
            resumes = resumes or int(done.action) != last  # the one that was interrupted is dropped
            if resumes:
                single.unwrapped.set_state(state)
                single.resume()
            in_exit_or_not = slice(None, None if resumes else -1)  # greed and plan may cross it at other moments
            assert single.action_masks().tolist()[in_exit_or_not] == mask[in_exit_or_not]
            _, reward, terminated, truncated, info = single.step(int(done.action))
            name, k = info["option"]["ended"], int(done.duration)
            assert ENDINGS[done.ended] == name
            assert abs(k - info["duration"]) <= most_apart, "greed and plan may take other ways to several buttons"
            bonus = 100.0 * bool(done.terminated)
            assert (float(done.reward), bool(done.terminated), bool(done.truncated)) == (
                reward + info["duration"] - k, terminated, truncated)
            assert float(done.discounted_reward) == pytest.approx(
                -(1 - 0.9**k) / 0.1 + bonus * 0.9 ** (k - 1), rel=1e-4, abs=1e-4)
            assert float(done.discount) == pytest.approx(0.9**k, rel=1e-5)
            assert [i for i in range(3) if int(done.pressed) >> i & 1] == np.flatnonzero(info["pressed"]).tolist()
            endings.add(name)
            resumes, last = name != "interrupted", int(done.action)
    expected = {"limited": "timeout", "failing": "planning-failed", "all missing": "planning-failed",
                "interrupted": "interrupted", "interrupted, limited": "timeout"}
    assert expected.get(kind, "reached") in endings


@pytest.mark.nightly_for("press", "press-with-ancestors")
@pytest.mark.parametrize("option_set", ["press", "press-with-ancestors"])
def test_doors_between_rooms_open_for_good_and_mask_what_is_behind_them(option_set):
    room, arguments = generate(get_preset("inner-doors"), 0), {"option_set": option_set, "include_primitives": False}
    env = BatchedOptionsEnv(3, instance=room, **arguments)
    single, masks, begun = OptionsEnv(EscapeRoomEnv(instance=room), **arguments), set(), set()
    for number, state, mask, done in replay(env, 12):
        single.reset(seed=number)
        single.unwrapped.set_state(state)
        single.resume()
        assert single.action_masks().tolist() == mask
        *_, terminated, truncated, info = single.step(int(done.action))
        assert (ENDINGS[done.ended], bool(done.terminated), bool(done.truncated)) == (
            info["option"]["ended"], terminated, truncated)
        assert abs(int(done.duration) - info["duration"]) <= 2 + info["duration"] // 10
        masks.add(tuple(mask))
        begun.add(mask[int(done.action)] and any(door for door in room.ways[int(done.action)]))
    assert len(masks) > 1 and begun == {True, False}, "doors were opened and passed"
    is_behind = np.array([bool(way) for way in room.ways])
    closed = min(masks, key=sum)
    assert not any(np.array(closed)[is_behind]) if option_set == "press" else all(closed[:-1])


def sort_targets(room):
    """Targets of a chain, from the first to be pressed to the last."""
    operators = room.puzzle.symbolic.make_symbolic_model().operators
    known, order = frozenset(), []
    while len(order) < len(operators):
        order.append(next(n for n, op in enumerate(operators) if op.preconditions <= known and not op.add <= known))
        known |= operators[order[-1]].add
    return order


@pytest.mark.nightly
def test_ancestors_are_pressed_first_and_what_is_on_is_not_pressed_again():
    room = generate(CHAIN, 0)
    last = sort_targets(room)[-1]
    env = BatchedOptionsEnv(1, instance=room, option_set="press-with-ancestors", include_primitives=False)
    env.reset(torch.arange(1))
    assert int(step_room(env, 0, last).pressed) == 0b111
    assert int(step_room(env, 0, last).pressed) == 1 << last


@pytest.mark.nightly_for("stopping", "with ancestors", "interrupted and worse")
@pytest.mark.parametrize("kind", ["with ancestors", "stopping", "interrupted and worse"])
def test_ragged_decisions_add_up_to_the_return_of_their_primitives(kind):
    """The oracle of SMDPs: R_0 + gamma^k_0 R_1 + ... is the discounted return of the episode, however it was cut."""
    gamma = 0.97
    room = dataclasses.replace(generate(CHAIN, 0), horizon=34 if "worse" in kind else 27)
    env = BatchedOptionsEnv(16, instance=room, discount=gamma, **KINDS[kind] | {"include_primitives": False})
    order = torch.tensor([*sort_targets(room), 3])
    env.reset(torch.arange(16))
    total, weight, length, episodes = torch.zeros(16), torch.ones(16), torch.zeros(16), []
    for number in range(130):
        lit = sum(env.room.state.puzzle >> n & 1 for n in range(3))
        wanted = torch.where(torch.arange(16) + number // 4 % 5 == 0, 1, order[lit])  # now and then another one
        legal = torch.gather(env.action_mask, 1, wanted.unsqueeze(1)).squeeze(1)
        done = env.step(torch.where(legal, wanted, env.action_mask.to(torch.int64).argmax(1)))
        total = torch.where(done.where, total + weight * done.discounted_reward, total)
        weight = torch.where(done.where, weight * done.discount, weight)
        length = torch.where(done.where, length + done.duration, length)
        assert torch.equal(length[done.where].int(), done.primitives[done.where])
        over = done.where & (done.terminated | done.truncated)
        for room in over.nonzero().squeeze(1).tolist():
            n, bonus = int(length[room]), 100.0 * bool(done.terminated[room])
            expected = -(1 - gamma**n) / (1 - gamma) + bonus * gamma ** (n - 1)
            assert float(total[room]) == pytest.approx(expected, rel=1e-4, abs=1e-3)
            assert float(weight[room]) == pytest.approx(gamma**n, rel=1e-4)
            episodes.append((n, bonus))
        total, length = total.masked_fill(over, 0.0), length.masked_fill(over, 0.0)
        weight = weight.masked_fill(over, 1.0)
    assert len({n for n, _ in episodes}) >= 3 and {bonus for _, bonus in episodes} == {0.0, 100.0}


def step_room(env, room, choice):
    """One decision of one room, the others turning on the spot or whatever they do."""
    for _ in range(300):
        done = env.step(torch.full((env.count,), choice))
        if done.where[room]:
            return type(done)(*(field[room] for field in done))
    raise AssertionError("the decision does not end")


def test_a_vector_environment_takes_the_same_kinds():
    many = gymnasium.make_vec("hrl_escape/PaperTwoButtonOptions-v1", num_envs=3, options=OptionDegradation(detour=2),
                              include_primitives=False)
    one = gymnasium.make("hrl_escape/PaperTwoButtonOptions-v1", options=OptionDegradation(detour=2),
                         include_primitives=False)
    many.reset(seed=0)
    one.reset(seed=0)
    *_, infos = many.step(np.array([0, 0, 0]))
    assert infos["duration"].tolist() == [one.step(0)[4]["duration"]] * 3 == [11] * 3


@pytest.mark.parametrize(("argument", "value"), [("trace", True), ("discounted_reward", True),
                                                 ("option_features", True), ("planner", "RRTConnect")])
def test_what_only_one_room_has_is_refused_by_name(argument, value):
    with pytest.raises(UnsupportedError, match=f"{argument} = .*gymnasium.make"):
        gymnasium.make_vec("hrl_escape/PaperTwoButtonOptions-v1", num_envs=2, **{argument: value})


@pytest.mark.parametrize(("arguments", "error", "words"), [
    ({"option_set": "press-reactive"}, UnsupportedError, "not by the state alone"),
    ({"option_set": "pres"}, UnknownNameError, "press-with-ancestors"),
    ({"options": OptionDegradation(latency=0.1)}, UnsupportedError, "latency"),
    ({"options": []}, UnsupportedError, "meta-actions only"),
])
def test_other_kinds_are_refused(arguments, error, words):
    with pytest.raises(error, match=words):
        BatchedOptionsEnv(2, CHAIN, **arguments)


def test_rooms_whose_doors_shut_again_are_refused():
    with pytest.raises(UnsupportedError, match="cells that shut again.*OptionsEnv"):
        BatchedOptionsEnv(2, "sokoban")
