"""Batched options of every kind on an accelerator, decision by decision as on a CPU: `pytest -m gpu tests/options`."""

import dataclasses

import pytest
import torch

from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.presets import get_preset
from hrl_escape.env.sampling.generation import generate
from hrl_escape.options.batched.env import BatchedOptionsEnv
from hrl_escape.options.degraded import OptionDegradation
from tests.options.batched.test_batched_env import NOISY, SMALL
from tests.options.batched.test_grips import ROOMS
from tests.options.batched.test_rectangles import KINDS

ROOM_KINDS = {
    "pressed by body": lambda: [generate(SMALL, 0)],
    "noise": lambda: [generate(NOISY, 0)],
    "pressed by hand": lambda: [generate(get_preset("arm-two-button"), 0)],
    "inner doors": lambda: [generate(get_preset("inner-doors"), 0)],
    "rectangle": lambda: [generate(KINDS["strafing"][0], seed) for seed in range(2)],
    "rectangle with a differential drive": lambda: [generate(KINDS["differential"][0], 0)],
    "rectangle by hand": lambda: [generate(KINDS["by hand"][0], 0)],
} | ROOMS


def play(instances: list[RoomInstance], device: str, decisions: int, **arguments) -> torch.Tensor:
    """What the rooms of a batch hand over in steps of masked random actions, float64 (steps, fields, rooms)."""
    env = BatchedOptionsEnv(64, instance=instances, device=device, **arguments)
    env.reset(torch.arange(64, device=device))
    generator, rows = torch.Generator().manual_seed(0), []
    for _ in range(decisions):
        mask = env.action_mask.double().cpu()
        done = env.step(torch.multinomial(mask, 1, generator=generator).squeeze(1).to(device))
        fields = (done.where, done.action, done.reward, done.duration, done.ended, done.pressed)
        rows.append(torch.stack([*(field.double().cpu() for field in fields), mask.sum(1)]))
    return torch.stack(rows)


@pytest.mark.gpu
@pytest.mark.parametrize("is_compiled", [False, True])
@pytest.mark.parametrize("kind", ROOM_KINDS)
def test_options_on_an_accelerator_do_what_they_do_on_the_cpu(kind, is_compiled):
    instances = ROOM_KINDS[kind]()
    on_cpu = play(instances, "cpu", 60)
    assert on_cpu[:, 0].sum() > 100, "decisions end"
    assert torch.equal(play(instances, "cuda", 60, compile=is_compiled), on_cpu)


@pytest.mark.gpu
def test_degraded_options_draw_alike_on_an_accelerator():
    worse = OptionDegradation(failure=0.2, early_stop=0.1, detour=2, missing=0.3, option_set="press-with-ancestors")
    room = [generate(dataclasses.replace(SMALL, name="worse"), 1)]
    found = [play(room, device, 100, options=worse, interruptible=True) for device in ("cpu", "cuda")]
    assert torch.equal(*found)
