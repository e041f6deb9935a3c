"""Algorithms of Stable-Baselines3 train in the loop of `train` as in their own, and frozen policies act as they are."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest

from hrl_escape.agents import AgentSpec, FrozenAgent, SB3Agent, evaluate, load_agent, train
from hrl_escape.errors import AgentSettingsError, UnsupportedSpaceError

stable_baselines3 = pytest.importorskip("stable_baselines3")


class Swing(gymnasium.Env):
    """A walk without chance: eight cells, from the middle; the right end pays 1. Episodes of at most 12 steps."""

    observation_space = gymnasium.spaces.Box(-1, 1, (8,), np.float32)
    action_space = gymnasium.spaces.Discrete(2)

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[Any, dict[str, Any]]:
        self.place, self.steps = 4, 0
        return self._look(), {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        self.place, self.steps = max(self.place + (1 if action else -1), 0), self.steps + 1
        done = self.place == 7
        return self._look(), float(done), done, self.steps == 12 and not done, {}

    def _look(self) -> Any:
        return np.eye(8, dtype=np.float32)[self.place]


class Push(Swing):
    """The same, by the sign of a force."""

    action_space = gymnasium.spaces.Box(-2, 2, (1,), np.float32)

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        return super().step(action[0] > 0)


@pytest.mark.parametrize(("algorithm", "arguments"), [("PPO", {"n_steps": 32, "n_epochs": 2}),
                                                      ("DQN", {"learning_starts": 20, "train_freq": 4})])
def test_training_in_the_loop_gives_the_weights_of_training_alone(algorithm: str, arguments: dict[str, Any]):
    kind = getattr(stable_baselines3, algorithm)
    alone = kind("MlpPolicy", Swing(), seed=3, device="cpu", **arguments).learn(128)
    looped: Any = train(SB3Agent(kind, **arguments), Swing(), primitives=128, seed=3, eval_every=40, eval_episodes=2,
                        progress=False).agent
    expected = alone.policy.state_dict()
    found = looped.model.policy.state_dict()
    assert all((found[name] == expected[name]).all() for name in expected)  # evaluations in between changed nothing


def test_a_run_that_cannot_be_saved_starts_again_and_a_finished_one_is_kept(tmp_path: Path):
    spec = SB3Agent(stable_baselines3.PPO, n_steps=32)
    first = train(spec, Swing(), primitives=96, seed=0, eval_episodes=1, out=tmp_path / "run", progress=False)
    again = train(spec, Swing(), primitives=96, seed=0, eval_episodes=1, out=tmp_path / "run", progress=False)
    assert again == first and again.resumed_at == first.primitives
    loaded = load_agent(tmp_path / "run", Swing(), trust=True)
    assert evaluate(loaded, Swing(), 2).returns == evaluate(first.agent, Swing(), 2).returns  # type: ignore[arg-type]


def test_a_spec_of_text_is_the_same_and_bad_arguments_are_named():
    spec = SB3Agent(stable_baselines3.PPO, over_options=True, n_steps=32)
    assert spec == AgentSpec.parse('smdp-sb3(algorithm=PPO,arguments={"n_steps":32})') and spec.chooses_options
    assert spec.title == "PPO of SB3 over options"
    with pytest.raises(AgentSettingsError, match="no_such"):
        train(SB3Agent(stable_baselines3.PPO, no_such=1), Swing(), primitives=10, progress=False)
    with pytest.raises(AgentSettingsError, match="in stable_baselines3 or sb3_contrib"):
        train("sb3(algorithm=Nothing)", Swing(), primitives=10, progress=False)


def test_masks_reach_the_algorithms_that_take_them():
    contrib = pytest.importorskip("sb3_contrib")

    class OnlyRight(gymnasium.Wrapper):
        def reset(self, **named: Any) -> Any:
            observation, info = self.env.reset(**named)
            return observation, {**info, "action_mask": np.array([0, 1], np.int8)}

        def step(self, action: Any) -> Any:
            assert action == 1, "a masked action"
            *step, info = self.env.step(action)
            return *step, {**info, "action_mask": np.array([0, 1], np.int8)}

    result = train(SB3Agent(contrib.MaskablePPO, n_steps=16), OnlyRight(Swing()), primitives=60, eval_episodes=1,
                   progress=False)
    assert result.evaluations[0].mean_return == 1.0


def test_frozen_policies_of_both_kinds_act_as_they_are():
    model = stable_baselines3.PPO("MlpPolicy", Swing(), seed=1, device="cpu")
    observations = np.eye(8, dtype=np.float32)
    frozen, legal = FrozenAgent(model), np.ones(2, bool)
    assert [frozen.act(each, legal) for each in observations] == [
        int(model.predict(each, deterministic=True)[0]) for each in observations]
    assert evaluate(FrozenAgent(lambda observation: [1]), Swing(), 1).returns == (1.0,)
    assert evaluate(FrozenAgent(lambda observation, mask: int(mask[0]) - 1), Swing(), 1).returns == (0.0,)
    with pytest.raises(AgentSettingsError, match="a model with `predict`"):
        FrozenAgent("ppo")
    with pytest.raises(UnsupportedSpaceError, match=r"returned \[0, 1\]"):
        evaluate(FrozenAgent(lambda observation: [0, 1]), Swing(), 1)


def test_a_model_with_actions_in_a_box_trains_and_is_evaluated_as_it_is():
    arguments: dict[str, Any] = {"learning_starts": 20, "buffer_size": 200, "batch_size": 8,
                                 "policy_kwargs": {"net_arch": [8]}}
    alone = stable_baselines3.SAC("MlpPolicy", Push(), seed=3, device="cpu", **arguments).learn(50)
    result = train(SB3Agent(stable_baselines3.SAC, **arguments), Push(), primitives=50, seed=3, eval_every=21,
                   eval_episodes=1, progress=False)
    looped: Any = result.agent
    expected, found = alone.policy.state_dict(), looped.model.policy.state_dict()
    assert all((found[name] == expected[name]).all() for name in expected)
    env, frozen = gymnasium.make("Pendulum-v1"), FrozenAgent(stable_baselines3.SAC(
        "MlpPolicy", "Pendulum-v1", seed=3, device="cpu", policy_kwargs={"net_arch": [8]}))
    returns, seen = evaluate(frozen, env, 2).returns, np.array([0.6, -0.8, 2.0], np.float32)
    assert -2 < frozen.act(seen, np.ones(0, bool))[0] < 2 and returns[0] < -100
    batched = FrozenAgent(lambda seen: frozen.act(seen, np.ones(0, bool))[None]).player(
        env.observation_space, env.action_space, 0)
    assert evaluate(batched, env, 2).returns == returns, "a batch of one action is that action"
