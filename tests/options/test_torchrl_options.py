"""Options under TorchRL: specs hold, decisions are those of `OptionsEnv`, losses see their durations."""

from __future__ import annotations

import gymnasium
import pytest
import torch
from torchrl.collectors import Collector
from torchrl.data import Categorical, LazyTensorStorage, ReplayBuffer
from torchrl.envs import ActionMask, GymWrapper, SerialEnv, TransformedEnv
from torchrl.envs.utils import check_env_specs
from torchrl.modules import MLP, QValueActor
from torchrl.objectives import DQNLoss, ValueEstimators

from hrl_escape.errors import UnsupportedError
from hrl_escape.options import FunctionOption, OptionsEnv, OptionsGymWrapper, OptionsTorchRLEnv, SMDPTransform

ROOMS = 4


def make_env() -> OptionsTorchRLEnv:
    env = OptionsTorchRLEnv(ROOMS, "paper-two-button", discount=0.97, include_primitives=False)
    env.set_seed(0)
    return env


def make_actor(env: OptionsTorchRLEnv) -> QValueActor:
    actions = len(env.rooms.action_names)
    network = MLP(in_features=env.observation_spec["observation"].shape[-1], out_features=actions, num_cells=(8,))
    return QValueActor(network, spec=Categorical(actions), in_keys=["observation"], action_space="categorical",
                       action_mask_key="action_mask")


@pytest.mark.nightly
def test_specs_hold_and_rollouts_repeat():
    check_env_specs(make_env())
    first, second = (make_env().rollout(5, make_actor_of_chance(), break_when_any_done=False) for _ in range(2))
    assert (first["action"] == second["action"]).all()
    assert (first["next", "reward"] == second["next", "reward"]).all()


def make_actor_of_chance():
    """Uniform over legal actions, the same each time it is made."""
    generator = torch.Generator().manual_seed(0)

    def choose(tensordict):
        drawn = tensordict["action_mask"].float().multinomial(1, generator=generator)
        return tensordict.set("action", drawn.squeeze(-1))

    return choose


@pytest.mark.nightly
def test_rewards_are_discounted_sums_over_the_decisions():
    """-1 a primitive and 100 more for the last one of an escape, in closed form."""
    data = make_env().rollout(40, make_actor_of_chance(), break_when_any_done=False)
    reward, duration, escaped = (data["next", key].double() for key in ("reward", "duration", "terminated"))
    expected = -(1 - 0.97**duration) / 0.03 + 100 * escaped * 0.97 ** (duration - 1)
    assert escaped.sum() > 0 and duration.unique().numel() > 5
    assert torch.allclose(reward, expected, atol=1e-4)


def test_losses_discount_by_the_durations():
    """By hand: the target of a decision of k primitives discounts by gamma^k."""
    env = make_env()
    actor = make_actor(env)
    loss = DQNLoss(actor, loss_function="l2", delay_value=True, action_space="categorical")
    loss.make_value_estimator(ValueEstimators.TD0, gamma=0.97)
    (data,) = Collector(env, actor, frames_per_batch=ROOMS * 6, total_frames=ROOMS * 6, postproc=SMDPTransform())
    buffer = ReplayBuffer(storage=LazyTensorStorage(100), transform=SMDPTransform(), batch_size=200)
    buffer.extend(data.exclude("steps_to_next_obs").reshape(-1))
    for batch in (data.reshape(-1), buffer.sample()):
        assert batch["steps_to_next_obs"].unique().numel() > 1
        with torch.no_grad():
            network = actor.module[0]
            value = network(batch["observation"]).gather(1, batch["action"].unsqueeze(1))
            reached = network(batch["next", "observation"]).masked_fill(~batch["next", "action_mask"], -torch.inf)
            target = batch["next", "reward"] + 0.97 ** batch["next", "duration"] * (
                ~batch["next", "terminated"]) * reached.amax(1, keepdim=True)
            assert float(loss(batch)["loss"]) == pytest.approx(float(((value - target) ** 2).mean()), rel=1e-5)


def make_cart(**arguments) -> OptionsEnv:
    """A cart with two options that balance for some primitives, one of them legal only while the pole leans right."""
    options = [FunctionOption("balance", lambda seen: int(seen[2] + 0.3 * seen[3] > 0),
                              lambda seen: abs(seen[3]) < 0.1),
               FunctionOption("push-right", lambda seen: 1, lambda seen: seen[2] < 0, lambda seen: seen[2] >= 0)]
    return OptionsEnv(gymnasium.make("CartPole-v1"), options, discount=0.9, **arguments)


def test_an_environment_of_your_own_has_masks_durations_and_discounts_in_its_tensors():
    env, plain = OptionsGymWrapper(make_cart()), make_cart()
    check_env_specs(env)
    assert env.action_spec.n == 4
    data = TransformedEnv(OptionsGymWrapper(make_cart()), ActionMask()).rollout(200, break_when_any_done=True)
    state = env.reset(seed=3)
    observation, info = plain.reset(seed=3)
    assert state["duration"].item() == 0 and state["discount"].item() == 1 and "reward" not in state
    durations = set()
    for _ in range(30):
        assert torch.equal(state["observation"], torch.from_numpy(observation))
        assert state["action_mask"].tolist() == (info["action_mask"] != 0).tolist()
        action = int(torch.nonzero(state["action_mask"]).flatten()[-1])
        observation, _, terminated, truncated, info = plain.step(action)
        step = env.step(state.set("action", torch.tensor(action)))["next"]
        durations.add(int(step["duration"]))
        assert step["duration"].item() == info["duration"] and step["terminated"].item() == terminated
        assert step["discount"].item() == pytest.approx(0.9 ** info["duration"])
        assert step["reward"].item() == pytest.approx(info["discounted_reward"])
        state = step
        if terminated or truncated:
            break
    assert len(durations) > 1
    taken = data["action_mask"].gather(1, data["action"].unsqueeze(1))
    assert taken.all() and not data["action_mask"].all()
    with pytest.raises(UnsupportedError, match="GymWrapper"):
        OptionsGymWrapper(gymnasium.make("CartPole-v1"))
    assert isinstance(env, GymWrapper)


def test_a_collector_gathers_decisions_of_several_copies_for_losses():
    copies = SerialEnv(2, lambda: TransformedEnv(OptionsGymWrapper(make_cart()), ActionMask()))
    (data,) = Collector(copies, None, frames_per_batch=40, total_frames=40, postproc=SMDPTransform())
    assert data.shape == (2, 20) and data["next", "duration"].max() > 1
    assert torch.equal(data["steps_to_next_obs"], data["next", "duration"])
