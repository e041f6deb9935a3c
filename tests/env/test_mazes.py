"""Point mazes: walls hold, one maze and thousands agree, goals are reached by the shortest way."""

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.utils.env_checker import check_env

from hrl_escape.env.mazes import MAPS, REACH, STEPS, Maze
from hrl_escape.errors import BatchError, ConfigError, ResetNeededError, UnknownNameError


@pytest.mark.parametrize("name", MAPS)
def test_no_point_enters_a_wall_and_free_points_move_freely(name):
    maze, rng = Maze(name), np.random.default_rng(0)
    point, goal = maze.place(rng.random((500, 6)))
    assert not maze.hits_wall(point).any() and (maze.measure(point, goal) > 0).all()
    tensor = torch.from_numpy(point)
    for action in np.repeat(rng.uniform(-1, 1, (15, 500, 2)), 8, axis=0):
        wanted = point + 0.2 * action
        before, point = point, maze.move(point, action)
        tensor = maze.move(tensor, torch.from_numpy(action))
        assert not maze.hits_wall(point).any()
        assert (np.abs(point - before) <= 0.2 * np.abs(action) + 1e-9).all()
        free = ~maze.hits_wall(wanted) & ~maze.hits_wall(np.stack((wanted[:, 0], before[:, 1]), axis=1))
        assert np.allclose(point[free], wanted[free]) and free.any() and not free.all()
    assert np.allclose(point, tensor.numpy())


def test_the_environment_is_a_goal_environment_and_ends_at_the_goal_or_the_limit():
    env = gymnasium.make("hrl_escape/PointMaze-v1", maze="medium", max_steps=40)
    check_env(env.unwrapped, skip_render_check=True)
    seen, _ = env.reset(seed=1)
    assert env.observation_space.contains(seen)
    for step in range(1, 41):
        seen, reward, terminated, truncated, info = env.step(np.zeros(2, np.float32))
        assert reward == env.unwrapped.compute_reward(seen["achieved_goal"], seen["desired_goal"], info) == -1
        assert truncated == (step == 40) and not terminated
    env.unwrapped._point = seen["desired_goal"][None].astype(float) + [[REACH - 0.01, 0]]
    env.unwrapped._steps = 39
    _, reward, terminated, truncated, info = env.step(np.zeros(2, np.float32))
    assert (reward, terminated, truncated, info["is_success"]) == (0, True, False, True)


def test_many_mazes_step_as_one_and_save_their_episodes():
    many = gymnasium.make_vec("hrl_escape/PointMaze-v1", num_envs=6, maze="u", max_steps=9, reward="dense")
    one = many.unwrapped.make_single_env()
    rng = np.random.default_rng(0)
    seen, _ = many.reset(seed=3)
    for step in range(30):
        if step == 12:
            saved = many.unwrapped.state_dict()
        action = torch.from_numpy(rng.uniform(-1, 1, (6, 2)).astype(np.float32))
        one.reset()
        one._point, one._goal = seen["achieved_goal"][:1].double().numpy(), seen["desired_goal"][:1].double().numpy()
        alone, paid, over, _, _ = one.step(action[0].numpy())
        seen, reward, terminated, truncated, infos = many.step(action)
        reached = {name: part[0] for name, part in infos.get("final_obs", seen).items()}
        assert all(np.allclose(alone[name], part, atol=1e-5) for name, part in reached.items())
        assert float(reward[0]) == pytest.approx(paid, abs=1e-5) and bool(terminated[0]) == over
        if step >= 12:
            last = seen["observation"]
    again = gymnasium.make_vec("hrl_escape/PointMaze-v1", num_envs=6, maze="u", max_steps=9, reward="dense")
    again.reset(seed=0)
    again.unwrapped.load_state_dict(saved)
    rng = np.random.default_rng(0)
    actions = [rng.uniform(-1, 1, (6, 2)).astype(np.float32) for _ in range(30)][12:]
    for action in actions:
        there = again.step(torch.from_numpy(action))[0]["observation"]
    assert torch.equal(there, last)


def test_wrong_arguments_are_refused():
    with pytest.raises(UnknownNameError, match="large"):
        Maze("larg")
    with pytest.raises(ConfigError, match="below 1 m in a step"):
        Maze("u", speed=20.0)
    assert set(STEPS) == set(MAPS)
    one, many = (make("hrl_escape/PointMaze-v1") for make in (gymnasium.make, gymnasium.make_vec))
    with pytest.raises(ResetNeededError):
        one.unwrapped.step(np.zeros(2))
    many.reset(seed=0)
    with pytest.raises(BatchError, match=r"finite numbers of shape \(1, 2\)"):
        many.step(torch.tensor([[torch.nan, 0.0]]))
