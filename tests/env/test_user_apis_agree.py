"""One room alone, several in turn and a batch: the same seeds give the same episodes and the same information."""

import dataclasses

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from hrl_escape.env.config import DynamicsConfig, StartConfig
from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.env.presets import get_preset
from hrl_escape.env.torchrl_env import EscapeRoomTorchRLEnv
from hrl_escape.env.vector_env import EscapeRoomVectorEnv

CONFIG = dataclasses.replace(get_preset("four-button-chain"), start=StartConfig(choices=9), horizon=25,
                             dynamics=DynamicsConfig(noise=0.1, slip=0.1))


@pytest.mark.nightly_for("AutoresetMode.SAME_STEP")
@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
def test_alone_in_turn_and_in_a_batch_seeds_give_the_same_episodes_and_infos(mode):
    alone = EscapeRoomEnv(CONFIG)
    in_turn = SyncVectorEnv([lambda: EscapeRoomEnv(CONFIG)] * 3, autoreset_mode=mode)
    batch = EscapeRoomVectorEnv(3, CONFIG, autoreset_mode=mode)
    single, _ = alone.reset(seed=6)
    rng, ended = np.random.default_rng(0), False
    mine, others = batch.reset(seed=5), in_turn.reset(seed=5)
    assert np.allclose(single, mine[0][1], atol=1e-6)
    for _ in range(80):
        assert np.allclose(mine[0], others[0], atol=1e-6)
        for infos, more in ((mine[-1], others[-1]), (mine[-1].get("final_info"), others[-1].get("final_info"))):
            assert (infos is None) == (more is None)
            for name, values in (infos or {}).items():
                if name in ("final_info", "final_obs", "_final_info", "_final_obs"):
                    continue
                mask = infos.get(f"_{name}", ...)
                assert np.asarray(values).shape == np.asarray(more[name]).shape
                assert (values[mask] == more[name][mask]).all(), name
        actions = rng.integers(6, size=3)
        if ended and mode is AutoresetMode.NEXT_STEP:
            single, info = alone.reset()
            ended = False
        else:
            single, _, terminated, truncated, info = alone.step(actions[1])
            ended = terminated or truncated
            if ended and mode is AutoresetMode.SAME_STEP:
                single, info = alone.reset()
                ended = False
        mine, others = batch.step(actions), in_turn.step(actions)
        assert np.allclose(single, mine[0][1], atol=1e-6)
        assert info["instance"] == mine[-1]["instance"][1]
        assert info["pressed"].tolist() == mine[-1]["pressed"][1].tolist()
        assert info["buttons_on"].tolist() == mine[-1]["buttons_on"][1].tolist()
    for env in (alone, in_turn, batch):
        env.close()


def test_a_press_is_told_alike():
    envs = (gymnasium.make("hrl_escape/PaperOneButton-v1"),
            gymnasium.make_vec("hrl_escape/PaperOneButton-v1", 2, vectorization_mode="sync"),
            gymnasium.make_vec("hrl_escape/PaperOneButton-v1", 2))
    told = []
    for env in envs:
        env.reset(seed=0)
        actions = 2 if env is envs[0] else np.array([2, 2])
        infos = [env.step(actions)[-1] for _ in range(8)][-1]
        infos = env.step(actions)[-1]
        told.append(np.asarray(infos["pressed"]).reshape(-1, 1)[0].tolist())
        env.close()
    assert told == [[1], [1], [1]]


def test_final_info_is_there_only_when_an_episode_ended():
    env = EscapeRoomVectorEnv(2, dataclasses.replace(CONFIG, horizon=3), autoreset_mode=AutoresetMode.SAME_STEP)
    env.reset(seed=0)
    for number in range(1, 7):
        infos = env.step(np.array([4, 4]))[-1]
        assert ("final_info" in infos) == ("final_obs" in infos) == (number % 3 == 0)


def test_a_masked_reset_after_seeding_resets_and_seeds_only_the_rooms_in_the_mask():
    import torch
    from tensordict import TensorDict

    env = EscapeRoomTorchRLEnv(4, CONFIG)
    env.set_seed(0)
    env.reset()
    for _ in range(3):
        env.rand_step()
    before = [env.room.get_room_state(i) for i in range(4)]
    env.set_seed(100)

    def reset(*mask):
        env.reset(TensorDict({"_reset": torch.tensor(mask).unsqueeze(-1)}, batch_size=[4]))
        return [env.room.get_room_state(i) for i in range(4)]

    after = reset(False, True, False, True)
    assert [a == b for a, b in zip(before, after, strict=True)] == [True, False, True, False]
    assert env.room.state.seed.tolist() == [0, 101, 2, 103]
    further = reset(True, True, False, False)
    assert further[2:] == after[2:] and env.room.state.seed.tolist() == [100, 101, 2, 103]
    assert env.room.state.episode.tolist()[:2] == [0, 1]
    reset(True, True, True, True)
    assert env.room.state.seed.tolist() == [100, 101, 102, 103]
