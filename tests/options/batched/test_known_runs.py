"""Known runs of options change nothing but the time that a step takes."""

import dataclasses
from typing import Any

import numpy as np
import pytest
import torch

from hrl_escape.env.presets import get_preset
from hrl_escape.options.batched import env as batched
from hrl_escape.options.batched.env import BatchedOptionsEnv

BODY = get_preset("paper-two-button")
ARM = get_preset("arm-two-button")
NOISY = dataclasses.replace(ARM, dynamics=dataclasses.replace(ARM.dynamics, noise=0.05))
BOX = dataclasses.replace(BODY, robot=dataclasses.replace(BODY.robot, footprint="rectangle", body_length=0.6,
                                                          body_width=0.4))
ROOMS: dict[str, tuple[Any, dict[str, Any]]] = {
    "by body": (BODY, {}),
    "by hand": (ARM, {}),
    "with primitives": (BODY, {"include_primitives": True}),
    "several rooms": ("clutter", {"num_instances": 3}),
    "inner doors": ("inner-doors", {}),
    "grips": ("blocks-world", {}),
    "rectangles": (BOX, {}),
}


def make(name: str, monkeypatch, knows: bool, count: int = 48, **more) -> BatchedOptionsEnv:
    config, arguments = ROOMS[name]
    with monkeypatch.context() as patch:
        patch.setattr(batched, "repeats_runs", lambda *_: knows)
        settings: dict[str, Any] = {"include_primitives": False, **arguments, **more}
        return BatchedOptionsEnv(count, config, **settings)


def run(env: BatchedOptionsEnv, steps: int, seed: int = 0) -> list[np.ndarray]:
    """Everything that rooms do and report under random actions."""
    draws, found = torch.Generator().manual_seed(seed), []
    for _ in range(steps):
        done = env.step(torch.multinomial(env.action_mask.float(), 1, generator=draws).squeeze(1))
        found += [field[done.where].numpy() for field in done] + [field.numpy() for field in env.room.state]
    return found


def assert_equal(some: list[np.ndarray], others: list[np.ndarray]) -> None:
    for one, other in zip(some, others, strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.nightly_for("rectangles", "several rooms")
@pytest.mark.parametrize("name", ROOMS)
def test_known_runs_are_those_that_would_be_chosen(name, monkeypatch):
    knowing, choosing = make(name, monkeypatch, True), make(name, monkeypatch, False)
    assert knowing._known is not None and choosing._known is None
    for env in (knowing, choosing):
        env.reset(5)
    assert_equal(run(knowing, 60), run(choosing, 60))
    assert knowing._known._lengths


@pytest.mark.parametrize(("config", "arguments"), [
    (BODY, {}), (ARM, {"include_primitives": True}), (ARM, {"interruptible": True}), (ARM, {"num_instances": 2}),
    (NOISY, {})])
def test_runs_are_remembered_only_where_it_saves_time(config, arguments):
    settings: dict[str, Any] = {"include_primitives": False, "instance_seed": 0}
    assert BatchedOptionsEnv(2, ARM, **settings)._known is not None
    assert BatchedOptionsEnv(2, config, **{**settings, **arguments})._known is None


def test_known_runs_end_where_rooms_are_reset_or_moved(monkeypatch):
    knowing, choosing = make("by body", monkeypatch, True), make("by body", monkeypatch, False)
    found: list[list[np.ndarray]] = []
    for env in (knowing, choosing):
        env.reset(5)
        found.append(run(env, 40))
        env.reset(None, torch.arange(env.count) % 3 == 0)
        found[-1] += run(env, 15, seed=1)
    assert_equal(*found)
    assert knowing._known is not None
    within = knowing._known.is_followed & ~knowing.is_waiting
    assert within.any()
    knowing.room.set_room_state(0, knowing.room.get_room_state(0)._replace(x=0.5, y=0.5))
    knowing.step(torch.zeros(knowing.count, dtype=torch.int64))
    assert not knowing._known.is_followed[within].any()


def test_what_is_left_of_known_runs_is_written_down(monkeypatch):
    knowing, again = make("by body", monkeypatch, True), make("by body", monkeypatch, True)
    knowing.reset(5)
    run(knowing, 40)
    assert knowing._known is not None and (knowing._known.is_followed & ~knowing.is_waiting).any()
    again.reset(0)
    again.load_state_dict(knowing.state_dict())
    assert_equal(run(knowing, 30, seed=2), run(again, 30, seed=2))


def test_few_rooms_choose_where_all_do_the_same(monkeypatch):
    env = make("by body", monkeypatch, True)
    env.reset(5)
    env.step(torch.zeros(env.count, dtype=torch.int64))
    assert env._known is not None
    assert int(env._known.find_leading().sum()) == 1
