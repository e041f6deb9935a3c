"""The TorchRL environment: its specs, resets by mask, seeds, collectors and moves."""

import pytest
import torch
from torchrl.collectors import Collector
from torchrl.envs import check_env_specs

from hrl_escape.env.observations.base import list_observations
from hrl_escape.env.torchrl_env import EscapeRoomTorchRLEnv
from hrl_escape.env.vector_env import EscapeRoomVectorEnv
from hrl_escape.errors import ConfigError, UnsupportedError

LEFT = 2


@pytest.mark.parametrize("kind", sorted(one.name for one in list_observations() if one.is_vector))
@pytest.mark.parametrize("name", ["paper-two-button", "arm-two-button", "clutter"])
def test_its_specs_say_what_it_does(name, kind):
    check_env_specs(EscapeRoomTorchRLEnv(6, name, num_instances=2, observation=kind), seed=0)


@pytest.mark.nightly
def test_it_is_the_same_room_as_the_gymnasium_vector():
    ours = EscapeRoomTorchRLEnv(5, "clutter", num_instances=3)
    theirs = EscapeRoomVectorEnv(5, "clutter", num_instances=3, observation="features", output="torch")
    ours.set_seed(4)
    seen, _ = theirs.reset(seed=4)
    here = ours.reset()
    assert torch.equal(here["observation"], seen)
    generator = torch.Generator().manual_seed(0)
    for _ in range(40):
        action = torch.randint(theirs.room.actions, (5,), generator=generator)
        here = ours.step(here.set("action", action))["next"]
        seen, reward, terminated, truncated, infos = theirs.step(action)
        assert torch.equal(here["observation"], seen)
        assert torch.equal(here["reward"][:, 0], reward)
        assert torch.equal(here["done"][:, 0], terminated | truncated)
        assert torch.equal(here["buttons_on"], infos["buttons_on"])


def test_exits_and_resets_go_by_room():
    env = EscapeRoomTorchRLEnv(3, "paper-one-button", observation="state")
    env.set_seed(0)
    here = env.reset()
    for number in range(9):
        action = torch.tensor([LEFT, LEFT, LEFT if number % 2 else 3])
        stepped = env.step(here.set("action", action))
        here = stepped["next"]
    assert here["terminated"][:, 0].tolist() == [True, True, False]
    assert here["reward"][:, 0].tolist() == [99.0, 99.0, -1.0]
    assert here["buttons_on"][:, 0].tolist() == [1, 1, 0]
    mask = here.clone().set("_reset", here["done"])
    again = env.reset(mask)
    assert again["observation"][:, 1].tolist() == [0.0, 0.0, -1.0]
    assert not again["done"].any()


@pytest.mark.nightly
def test_the_same_seed_gives_the_same_rollout_and_a_collector_collects_it():
    def collect():
        env = EscapeRoomTorchRLEnv(4, "arm-two-button")
        env.set_seed(7)

        def policy(tensordict):
            number = tensordict["observation"].abs().sum(dim=-1) * 1000
            return tensordict.set("action", number.long() % env.room.actions)

        collector = Collector(env, policy, frames_per_batch=400, total_frames=1200)
        return torch.cat([batch["next", "observation"] for batch in collector], dim=1)

    first = collect()
    assert first.shape[:2] == (4, 300)
    assert torch.equal(first, collect())


def test_rooms_move_to_another_device_with_their_state():
    env = EscapeRoomTorchRLEnv(2)
    env.set_seed(0)
    here = env.reset()
    env.step(here.set("action", torch.tensor([LEFT, LEFT])))
    state = env.room.state
    assert env.to("cpu") is env
    assert all(torch.equal(a, b) for a, b in zip(env.room.state, state, strict=True))
    with pytest.raises(ConfigError, match="device"):
        env.to("cuda:99")


@pytest.mark.gpu
def test_rooms_on_an_accelerator_do_what_they_do_on_the_cpu():
    rows = []
    for device in ("cpu", "cuda"):
        env = EscapeRoomTorchRLEnv(64, "clutter", num_instances=4).to(device)
        env.set_seed(0)
        here = env.reset()
        for number in range(100):
            action = (torch.arange(64, device=device) * 7 + number * 5) % env.room.actions
            here = env.step(here.set("action", action))["next"]
        rows.append(here["observation"].cpu())
    assert (rows[0] - rows[1]).abs().max() < 1e-5


def test_what_the_bullet_engine_must_do_is_refused():
    with pytest.raises(UnsupportedError, match="vectorization_mode='sync'"):
        EscapeRoomTorchRLEnv(2, observation="pixels")
    with pytest.raises(UnsupportedError, match="physics"):
        EscapeRoomTorchRLEnv(2, "push-block")
