"""Own play in other people's environments: recorded, kept with Minari, made again, and learned from."""

from __future__ import annotations

import builtins
import importlib.util
import sys
import types

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.wrappers import FlattenObservation

from hrl_escape import OptionsEnv, train
from hrl_escape.data import PlayedData, from_minari, record_play, to_minari
from hrl_escape.errors import ActionError, ConfigError, UnsupportedError
from hrl_escape.options import FunctionOption, OptionDomain

minari = pytest.importorskip("minari")
pytest.importorskip("minigrid")

FORWARD, PICK, TOGGLE, GOAL = 2, 3, 5, 8
STEPS = ((1, 0), (0, 1), (-1, 0), (0, -1))


class Grid(OptionDomain):
    """The whole grid: cells, position, direction, and whether the key is carried and the door open."""

    def get_state(self, observation):
        """Return the environment itself as a picture: (cells, position, direction, carried)."""
        env = self.env.unwrapped
        return env.grid.encode(), tuple(map(int, env.agent_pos)), int(env.agent_dir), env.carrying is not None


def find(state, kind, want=None):
    cells = np.argwhere(state[0][..., 0] == kind)
    cells = [tuple(map(int, cell)) for cell in cells if want is None or state[0][tuple(cell)][2] == want]
    return cells[0] if cells else None


def head_for(state, target):
    """Next action of the shortest way to face a cell, by breadth-first search over poses."""
    cells, place, heading, _ = state
    queue, seen = [((place, heading), ())], {(place, heading)}
    for (here, way), path in queue:
        ahead = here[0] + STEPS[way][0], here[1] + STEPS[way][1]
        if ahead == target:
            return path[0] if path else None
        free = cells[ahead][0] in (1, GOAL) or (cells[ahead][0] == 4 and cells[ahead][2] == 0)
        for action, pose in ((0, (here, (way - 1) % 4)), (1, (here, (way + 1) % 4)), (FORWARD, (ahead, way))):
            if pose not in seen and (action != FORWARD or free):
                seen.add(pose)
                queue.append((pose, (*path, action)))
    return 0


def act_on(kind, action, want=None):
    def choose(state):
        move = head_for(state, find(state, kind, want))
        return action if move is None else move
    return choose


def make_options(env):
    """Three options: take the key, open the door, go to the goal."""
    del env
    has_key, door = (lambda s: s[3]), (lambda s: find(s, 4, 0) is not None)
    return [FunctionOption("take-key", act_on(5, PICK), has_key, lambda s: not has_key(s)),
            FunctionOption("open-door", act_on(4, TOGGLE), door, lambda s: has_key(s) and not door(s)),
            FunctionOption("reach-goal", act_on(GOAL, FORWARD), lambda s: False, door)]


def make_env(**arguments) -> OptionsEnv:
    from minigrid.wrappers import ImgObsWrapper

    grid = ImgObsWrapper(gymnasium.make("MiniGrid-DoorKey-5x5-v0", max_steps=60))
    return OptionsEnv(FlattenObservation(grid), make_options, domain=Grid, **arguments)


def play(env, seed=0, detour=True) -> PlayedData:
    """Two good episodes, after some turning on the spot in the first, and one that is ended before its end."""
    moves = iter([*[0, 0] * detour, "take-key", "open-door", "reach-goal"] * 2 + [1, "take-key"])
    return record_play(env, lambda observation, info: next(moves, None), episodes=3, seed=seed, name="door-key")


@pytest.fixture
def folder(tmp_path, monkeypatch):
    if importlib.util.find_spec("jax") is None:  # of which Minari's collector needs one function
        tree = types.ModuleType("jax.tree_util")
        tree.tree_map = torch.utils._pytree.tree_map
        jax = types.ModuleType("jax")
        jax.tree_util = tree
        monkeypatch.setitem(sys.modules, "jax", jax)
        monkeypatch.setitem(sys.modules, "jax.tree_util", tree)
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    return tmp_path


def test_play_holds_the_decisions_and_the_primitives_inside_them():
    data = play(make_env(discount=0.9))
    decisions, primitives = data.decisions, data.read_primitives()
    assert repr(data) == f"<PlayedData door-key: 3 episodes, 12 decisions, {len(primitives.action)} primitives>"
    assert decisions.duration.sum() == len(primitives.action) and decisions.duration.max() > 3
    assert decisions.terminated.tolist() == [False] * 4 + [True] + [False] * 4 + [True] + [False] * 2
    assert decisions.last.sum() == 3 and decisions.last[-1] and primitives.last.sum() == 3
    ends = np.cumsum(decisions.duration)
    np.testing.assert_array_equal(primitives.next_observation[ends - 1], decisions.next_observation)
    for gamma in (0.9, 0.5):  # by hand
        read = data.read_decisions(gamma)
        for row, (end, count) in enumerate(zip(ends, decisions.duration, strict=True)):
            rewards = primitives.reward[end - count : end]
            assert read.reward[row] == pytest.approx(sum(gamma**i * each for i, each in enumerate(rewards)))
            assert read.discount[row] == pytest.approx(gamma**count)


def test_minari_keeps_play_makes_its_environment_again_and_gives_it_back(folder):
    data = play(make_env(discount=0.9))
    primitives, decisions = to_minari(data, namespace="mine")
    assert decisions.spec.dataset_id == "mine/door-key-decisions-v1" and primitives.total_steps > decisions.total_steps
    again = minari.load_dataset("mine/door-key-decisions-v1").recover_environment()
    env = make_env(discount=0.9)
    assert again.get_wrapper_attr("action_names") == env.action_names
    for made in (again, env):
        made.reset(seed=5)
    for name in ("take-key", "open-door", "reach-goal"):
        one, other = (made.step(env.action_names.index(name)) for made in (again, env))
        np.testing.assert_array_equal(one[0], other[0])
        assert one[1:4] == other[1:4] and one[4]["discounted_reward"] == other[4]["discounted_reward"]
    back = from_minari("mine/door-key-decisions-v1")
    for field, was, now in zip(data.decisions._fields, data.decisions, back.read(), strict=True):
        np.testing.assert_array_equal(now, was, err_msg=field)
    with pytest.raises(ConfigError, match="0.9"):
        back.read_decisions(0.99)
    flat = from_minari("mine/door-key-primitives-v1")
    for field, was, now in zip(data.primitives._fields, data.primitives, flat.read_primitives(), strict=True):
        np.testing.assert_array_equal(now, was, err_msg=field)
    for kept in (primitives, decisions):
        ends = [(bool(episode.terminations[-1]), bool(episode.truncations[-1])) for episode in kept]
        assert ends == [(True, False), (True, False), (False, True)] and not kept[0].truncations.any()
    with pytest.raises(ConfigError, match="minari list local"):
        from_minari("mine/other-v1")


def test_agents_learn_from_play_directly_and_from_minari(folder):
    data, settings = play(make_env(discount=0.9), detour=False), {"values": "table", "gamma": 0.9, "bins": 256}
    to_minari(data, namespace="mine")
    results = [train("smdp-fitted-q+primitives", data=each, settings=settings, eval_episodes=2, progress=False)
               for each in (data, from_minari("mine/door-key-decisions-v1"))]
    assert results[0].evaluations == results[1].evaluations
    flat = train("behaviour-cloning", data=data, primitives=2_000, settings=settings, eval_episodes=1)
    assert flat.evaluations


def test_the_collector_of_minari_records_options_of_your_own_unmodified(folder):
    env = minari.DataCollector(make_env(discount=0.9), record_infos=True)
    for seed in (0, 1):
        env.reset(seed=seed)
        for name in ("take-key", "open-door", "reach-goal"):
            env.step(env.get_wrapper_attr("action_names").index(name))
    env.create_dataset("mine/collected-v0")
    data, mine = from_minari("mine/collected-v0"), play(make_env(discount=0.9), detour=False)
    for field, collected, played in zip(data.decisions._fields, data.decisions, mine.decisions, strict=True):
        np.testing.assert_array_equal(collected, played[:6], err_msg=field)


def test_a_person_is_asked_with_the_legal_actions(monkeypatch, capsys):
    answers = iter(["reach-goal", "99", "what", "take-key", "0", "q"])
    monkeypatch.setattr(builtins, "input", lambda text: next(answers))
    data = record_play(make_env())
    shown = capsys.readouterr().out
    assert data.decisions.action.tolist() == [7, 0] and not data.decisions.terminated.any()
    assert "7 take-key" in shown and "9 reach-goal" not in shown and "'reach-goal' is none of these actions" in shown


def test_play_that_cannot_be_kept_says_what_to_do(folder):
    listed = OptionsEnv(gymnasium.make("FrozenLake-v1"), [FunctionOption("go", lambda s: 1, lambda s: 1.0)])
    data = record_play(listed, lambda *_: "go")
    with pytest.raises(UnsupportedError, match=r"FunctionOption go.*my_options.make_options"):
        to_minari(data, namespace="mine")
    with pytest.raises(ActionError):
        record_play(listed, lambda *_: "jump")
    with pytest.raises(UnsupportedError, match="no decision"):
        record_play(listed, lambda *_: None)
    with pytest.raises(UnsupportedError, match="FlattenObservation"):
        record_play(OptionsEnv(gymnasium.make("MiniGrid-DoorKey-5x5-v0"), make_options, domain=Grid), lambda *_: 0)
