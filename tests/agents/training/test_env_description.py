"""The identity of a run: everything that decides its numbers, the environment's arguments and the room included."""

from __future__ import annotations

import functools
import json
import pickle
from importlib import import_module
from pkgutil import resolve_name, walk_packages

import gymnasium
import numpy as np
import pytest

import hrl_escape
from hrl_escape.agents import load_agent, train
from hrl_escape.agents.algorithms.q_learning import QLearning
from hrl_escape.agents.training.checkpoint import compute_state_digest
from hrl_escape.agents.training.env_description import (
    OWN,
    describe_env,
    hash_large_parts,
    make_described_env,
    name_part,
)
from hrl_escape.agents.training.train import load_env
from hrl_escape.env.presets import get_preset
from hrl_escape.env.sampling.generation import generate
from hrl_escape.errors import CheckpointError, RunMismatchError, TrustError
from hrl_escape.options.meta_actions import make_meta_options
from hrl_escape.options.options_env import OptionsEnv
from tests.agents.small_envs import ButtonGrid


def make_room(seed=0, **arguments):
    room = {} if "instance" in arguments else {"config": "four-button-chain", "instance_seed": seed}
    return gymnasium.make("hrl_escape/EscapeRoom-v1", **room | {"observation": "features"} | arguments)


def make_options(seed=0, **arguments):
    return OptionsEnv(make_room(seed), **arguments)


def run(env, out, **arguments):
    has_primitives = env.has_wrapper_attr("primitive_count") and env.get_wrapper_attr("primitive_count") > 0
    agent = "smdp-q-learning+primitives" if has_primitives else "smdp-q-learning"
    return train(agent, env, out=out, **{"primitives": 200, "eval_episodes": 1} | arguments)


@pytest.mark.parametrize("env", [
    make_room(), make_options(option_set="press-with-ancestors", include_primitives=False),
    make_room(config="clutter", resample_instance=True), gymnasium.make("CartPole-v1", max_episode_steps=9),
])
def test_an_environment_made_from_its_description_acts_the_same(env):
    description = json.loads(json.dumps(describe_env(env)))
    again = make_described_env(description)
    assert "CartPole" in description["class"] or describe_env(again) == description
    ends = []
    for each in (env, again):
        observations = [each.reset(seed=3)[0]]
        each.action_space.seed(0)
        observations += [each.step(each.action_space.sample())[0] for _ in range(6)]
        ends.append(np.array(observations))
    np.testing.assert_array_equal(*ends)


def test_wrappers_that_change_nothing_are_no_part_of_a_description():
    passive = gymnasium.wrappers.RecordEpisodeStatistics(make_room())
    assert describe_env(passive) == describe_env(make_room())
    changed = gymnasium.wrappers.TransformReward(make_room(), abs)
    assert describe_env(changed)["wrappers"][0]["arguments"] == {"func": {"function": "builtins:abs"}}


def test_a_rooms_name_and_its_drawing_are_no_part_of_its_identity():
    room = generate(get_preset("four-button-chain"), 0)
    here, there = make_room(render_mode="rgb_array"), make_room(instance=room.to_dict() | {"name": "other"})
    assert hash_large_parts(describe_env(here)) == hash_large_parts(describe_env(there))


@pytest.mark.nightly_for(
    "<lambda>-arguments0-environment.arguments.instance",
    "<lambda>-arguments1-environment.wrappers.0.arguments.option_set: 'press' there, 'press-with-ancestors' now",
    "make_options-arguments5-primitives: 200 there, 300 now", "make_options-arguments7-evaluation_environment",
    "<lambda>-arguments3-environment.arguments.observation",
    "<lambda>-arguments2-environment.wrappers.0.arguments.max_duration", "make_options-arguments4-seed: 0 there, 1 now")
@pytest.mark.parametrize(("env", "arguments", "field"), [
    (lambda: make_options(seed=1), {}, "environment.arguments.instance"),
    (lambda: make_options(option_set="press-with-ancestors"), {},
     "environment.wrappers.0.arguments.option_set: 'press' there, 'press-with-ancestors' now"),
    (lambda: make_options(max_duration=50), {}, "environment.wrappers.0.arguments.max_duration"),
    (lambda: make_room(observation="state"), {}, "environment.arguments.observation"),
    (make_options, {"seed": 1}, "seed: 0 there, 1 now"),
    (make_options, {"primitives": 300}, "primitives: 200 there, 300 now"),
    (make_options, {"settings": {"gamma": 0.9}}, "settings.gamma: .* there, 0.9 now"),
    (make_options, {"eval_env": make_options(seed=2)}, "evaluation_environment"),
])
def test_a_finished_run_is_never_returned_as_another_ones(tmp_path, env, arguments, field):
    first = run(make_options(), tmp_path / "run")
    with pytest.raises(RunMismatchError, match=field):
        run(env(), tmp_path / "run", **arguments)
    assert run(make_options(), tmp_path / "run") == first
    other = run(env(), tmp_path / "run-{key}", **arguments)
    assert other.folder != run(make_options(), tmp_path / "run-{key}").folder


def test_another_version_of_the_package_is_another_run(tmp_path, monkeypatch):
    run(make_options(), tmp_path / "run")
    monkeypatch.setattr("hrl_escape.agents.training.run.__version__", "999.0")
    with pytest.raises(RunMismatchError, match="version: .* there, '999.0' now"):
        run(make_options(), tmp_path / "run")


def test_options_given_as_objects_are_told_apart():
    room = generate(get_preset("four-button-chain"), 0)
    press, others = (make_options(options=make_meta_options(room, option_set)[:count])
                     for option_set, count in (("press", 2), ("press", 1)))
    assert hash_large_parts(describe_env(press)) != hash_large_parts(describe_env(others))
    with pytest.raises(CheckpointError, match="is not kept with a run. Make it and give env="):
        make_described_env(describe_env(press))


def make_scaling(factor, kind=float):
    """A function with bound values, and one that is called by itself."""
    def scale(reward):
        return kind(reward) * factor if reward < 9 else scale(reward - 9)
    return scale


@pytest.mark.parametrize(("one", "other"), [
    (lambda reward: reward, lambda reward: 2 * reward), (lambda reward: reward + 1, lambda reward: reward + 2),
    (lambda reward: reward.real, lambda reward: reward.imag), (lambda reward: abs(reward), lambda reward: int(reward)),
    (make_scaling(2.0), make_scaling(3.0)), (make_scaling(2.0), make_scaling(2.0, int)),
    (lambda reward, by=2: reward * by, lambda reward, by=3: reward * by),
    (lambda reward, *, by=2: reward * by, lambda reward, *, by=3: reward * by),
    (lambda reward: (lambda more: more + 1)(reward), lambda reward: (lambda more: more + 2)(reward)),
    (lambda reward: (lambda more: more.real)(reward), lambda reward: (lambda more: more.imag)(reward)),
    (lambda reward: reward in {1, 2}, lambda reward: reward in {1, 3}),
    (functools.partial(max, 1), functools.partial(max, 2)), (functools.partial(max, 1), functools.partial(min, 1)),
    (functools.partial(make_scaling(2.0)), functools.partial(make_scaling(3.0))),
], ids=["code", "constant", "attribute", "global", "bound", "bound class", "default", "default by name",
        "constant of a function within", "name in a function within", "set", "argument", "function", "bound argument"])
def test_functions_without_a_name_are_told_apart_by_their_content(one, other):
    first, second, again = (describe_env(gymnasium.wrappers.TransformReward(ButtonGrid(), function))
                            for function in (one, other, one))
    assert first == again and first != second
    with pytest.raises(CheckpointError, match="is not kept with a run"):
        make_described_env({**first, "class": "gymnasium.envs.classic_control.cartpole:CartPoleEnv", "arguments": {}})


@pytest.mark.nightly
def test_environment_and_agent_of_a_run_are_made_from_its_folder(tmp_path):
    result = run(make_options(option_set="press-with-ancestors"), tmp_path / "run")
    env = load_env(tmp_path / "run")
    assert describe_env(env) == describe_env(make_options(option_set="press-with-ancestors"))
    agent, trained = load_agent(tmp_path / "run"), result.agent
    observation, info = env.reset(seed=1)
    chosen = [a.act_greedy(observation, info["action_mask"].astype(bool), np.random.default_rng(0))
              for a in (agent, trained)]
    assert chosen[0] == chosen[1]


def test_a_set_is_the_same_in_whatever_order_it_was_filled():
    """8 and 0 fall into one place of a small set, so that the first of them comes first."""
    one, other = ({8, 0}, {0, 8})
    assert repr(one) != repr(other)
    first, second, third = (describe_env(gymnasium.wrappers.TransformReward(ButtonGrid(), functools.partial(max, each)))
                            for each in (one, other, {0, 7}))
    assert first == second != third


class Named(QLearning):
    """A learner of one's own, which no entry point tells of."""

    name = "named"


def test_a_run_of_an_agent_of_ones_own_is_loaded_where_it_is_trusted(tmp_path):
    env = make_options()
    agent = Named(env.observation_space, env.action_space, 3, Named.Settings(gamma=0.9, learning_rate=0.2))
    trained = train(agent, env, primitives=200, eval_episodes=0, out=tmp_path / "run")
    assert trained.agent_name == "named"
    with pytest.raises(TrustError, match="test_env_description:Named', which may do anything"):
        load_agent(tmp_path / "run")
    loaded = load_agent(tmp_path / "run", trust=True)
    assert type(loaded).__qualname__ == "Named" and loaded.settings == agent.settings
    assert compute_state_digest(loaded.state_dict()) == compute_state_digest(agent.state_dict())
    described = json.loads((tmp_path / "run" / "run.json").read_text())
    assert described["agent"].endswith("test_env_description:Named")
    assert type("Variant", (QLearning,), {}).name == "Variant", "and not that of the algorithm that it varies"


class Forgetful(ButtonGrid):
    """A grid that keeps none of its arguments under their names."""

    def __init__(self, most: int) -> None:
        super().__init__(horizon=most)


class Doubled(gymnasium.RewardWrapper):
    """A wrapper that does not record its arguments for Gymnasium."""

    def __init__(self, env: gymnasium.Env, factor: float = 2.0) -> None:
        super().__init__(env)
        self._factor = factor

    def reward(self, reward):
        return self._factor * reward

    def step(self, action):
        """Scale the rewards of the primitives inside a decision, too."""
        observation, reward, terminated, truncated, info = super().step(action)
        if "rewards" in info:
            info = info | {"rewards": tuple(map(self.reward, info["rewards"]))}
        return observation, reward, terminated, truncated, info


def test_an_environment_whose_arguments_are_not_kept_must_be_given(tmp_path):
    train("q-learning", Forgetful(90), primitives=100, eval_episodes=0, out=tmp_path / "run")
    with pytest.raises(CheckpointError, match=r"most of .*Forgetful is not kept with a run. Make it and give env="):
        load_agent(tmp_path / "run", trust=True)
    assert load_agent(tmp_path / "run", Forgetful(90))


def test_a_run_over_an_environment_of_ones_own_asks_for_trust(tmp_path):
    train("q-learning", Doubled(ButtonGrid(horizon=90)), primitives=100, eval_episodes=0, out=tmp_path / "run")
    with pytest.raises(TrustError, match=r"small_envs:ButtonGrid', '.*:Doubled', which may do anything") as raised:
        load_agent(tmp_path / "run")
    assert pickle.loads(pickle.dumps(raised.value)).names == raised.value.names  # our own bytes, made here
    assert load_agent(tmp_path / "run", trust=True)
    gymnasium.register("Test/Grid-v0", ButtonGrid)
    try:
        with pytest.raises(TrustError) as raised:
            load_env(tmp_path / "run")
    finally:
        del gymnasium.registry["Test/Grid-v0"]
    assert raised.value.names == (f"{__name__}:Doubled",), "who registers an environment allows it"


def test_parts_that_an_installed_package_lists_need_no_trust(tmp_path, monkeypatch):
    package = tmp_path / "extra.dist-info"
    package.mkdir()
    (package / "METADATA").write_text("Metadata-Version: 2.1\nName: extra\nVersion: 1\n")
    (package / "entry_points.txt").write_text(
        f"[hrl_escape.parts]\ngrid = tests.agents.small_envs:ButtonGrid\ndoubled = {__name__}:Doubled\n")
    monkeypatch.syspath_prepend(tmp_path)
    description = describe_env(Doubled(ButtonGrid(horizon=90)))
    assert describe_env(make_described_env(description)) == description


@pytest.mark.parametrize(("env", "other", "field"), [
    (ButtonGrid(horizon=90), ButtonGrid(horizon=95), "environment.arguments.horizon: 90 there, 95 now"),
    (Doubled(ButtonGrid()), Doubled(ButtonGrid(), 3.0), "environment.wrappers.0.arguments.factor: 2.0 there, 3.0 now"),
])
def test_arguments_are_read_from_the_attributes_that_bear_their_names(tmp_path, env, other, field):
    train("q-learning", env, primitives=100, eval_episodes=0, out=tmp_path / "run")
    with pytest.raises(RunMismatchError, match=field):
        train("q-learning", other, primitives=100, eval_episodes=0, out=tmp_path / "run")
    train("q-learning", env, primitives=100, eval_episodes=0, out=tmp_path / "run")
    again = load_env(tmp_path / "run", trust=True)
    assert describe_env(again) == describe_env(env) != describe_env(other)


@pytest.mark.parametrize("content", [[1], {"format": 1}, {}])
def test_the_description_of_no_run_is_refused(tmp_path, content):
    (tmp_path / "run.json").write_text(json.dumps(content))
    with pytest.raises(CheckpointError, match="not the description of a run in format 3"):
        load_env(tmp_path)


def test_a_description_cannot_call_what_is_no_environment():
    described = {"class": "os:getcwd", "arguments": {}, "wrappers": []}
    with pytest.raises(TrustError, match="this run would import and call 'os:getcwd'"):
        make_described_env(described)
    with pytest.raises(CheckpointError, match="os:getcwd is no Env"):
        make_described_env(described, trust=True)


@pytest.mark.parametrize("wrapper", ["RecordVideo", "HumanRendering"])
def test_wrappers_that_write_files_or_open_windows_ask_for_trust(wrapper):
    described = describe_env(make_room())
    described["wrappers"] = [{"class": f"gymnasium.wrappers.rendering:{wrapper}", "arguments": {}}]
    with pytest.raises(TrustError, match=wrapper):
        make_described_env(described)


def test_every_environment_and_wrapper_of_the_package_is_a_known_part():
    """Those of pages and private ones stand in no description: they are passive, or never described."""
    found = set()
    for module in walk_packages(hrl_escape.__path__, "hrl_escape."):
        if not module.name.removeprefix("hrl_escape.").startswith(("viewer", "commands", "checks", "text.mcp")):
            for kind in vars(import_module(module.name)).values():
                is_own = isinstance(kind, type) and kind.__module__ == module.name and not kind.__name__.startswith("_")
                if is_own and issubclass(kind, (gymnasium.Env, gymnasium.Wrapper)):
                    found.add(name_part(kind))
    parts = {name_part(resolve_name(name)) for name in OWN}
    assert parts == OWN
    assert found <= OWN | {"hrl_escape.benchmark.episodes:StateRecorder"}, "a recorder changes no number"
