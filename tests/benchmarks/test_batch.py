"""Steps per second of batched rooms: contenders, bounds, JSON, plot and refusals."""

from __future__ import annotations

import json

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from benchmarks.batch_contenders import (
    BatchSettings,
    Contender,
    count_bytes,
    count_moved_bytes,
    draw_uniformly,
    list_makers,
    set_arithmetic_bounds,
)
from hrl_escape.env.batched.engine import TensorRoom
from hrl_escape.env.batched.rooms import Rooms
from hrl_escape.env.presets import get_preset
from hrl_escape.env.sampling.generation import generate
from hrl_escape.env.velocities import Velocities
from tests.command_line import call_script

QUICK = ("--seconds", "0.01", "--repeats", "1", "--threads", "1", "--engines", "eager", "--sizes", "2", "16")


def run(capsys, *arguments: object) -> tuple[int, str, str]:
    return call_script(capsys, "benchmarks.batch", *arguments)


@pytest.mark.nightly
def test_it_measures_our_batches_beside_others_in_one_run(capsys, tmp_path):
    plot = tmp_path / "batch.png"
    code, out, _ = run(capsys, *QUICK, "--scenes", "paper-two-button", "ten-obstacles-by-hand", "--json",
                       "--plot", str(plot))
    report = json.loads(out)
    assert code == 0
    rows = report["contenders"]
    ours = [(row["name"], row["engine"], row["rooms"]) for row in rows if row["memory_bound"]]
    assert ours == [(scene, "eager", size) for scene in ("paper-two-button", "ten-obstacles-by-hand")
                    for size in (2, 16)]
    assert {"CartPole-v1", "paper-two-button"} <= {row["name"] for row in rows if not row["memory_bound"]}
    for row in rows:
        assert row["steps_per_second"] == pytest.approx(1e6 * row["rooms"] / row["step_us"])
        assert row["memory_bound"] is None or row["state_bytes"] < 200 and 100 < row["moved_bytes"] < 300
        is_ours = row["memory_bound"] is not None
        assert row["share_of_arithmetic_bound"] <= 1.0 + 1e-9 if is_ours else row["arithmetic_bound"] is None
    assert report["machine"]["threads"] == 1
    assert Image.open(plot).size[0] > 500


def test_the_bytes_of_a_step_are_those_counted_by_hand():
    batch = TensorRoom(Rooms(3, instance=generate(get_preset("paper-two-button"), 0), observation="features"))
    batch.reset(torch.arange(3))
    before, action = batch.state, torch.zeros(3, dtype=torch.int64)
    outcome = batch.step(action)
    # x, y, puzzle, touching: 8 bytes each; heading, primitives, episode and end: 4 each
    changing = 4 * 8 + 4 * 4
    features, flags, info = 6 * 4, 1 + 1, 2 * 1 + 2 * 1 + 4  # info: pressed, on and success; the rest is the state's
    by_hand = changing + 8 + changing + features + 4 + flags + info
    assert count_moved_bytes((before, action), (batch.state, outcome)) == 3 * by_hand == 3 * 142
    assert count_bytes(before) == 3 * (changing + 4 * 8)  # heading offset, key, instance and seed are handed on


def contend(rooms: int, wall: float) -> Contender:
    return Contender("room", "compiled", rooms, lambda count: None, 0.0, 80, 100, wall, wall)


def test_the_arithmetic_bound_is_the_best_rate_beyond_a_smaller_batch():
    batches = [contend(100, 2e-6), contend(1100, 4e-6), contend(10_100, 30e-6)]
    set_arithmetic_bounds(batches)
    assert [one.arithmetic_bound for one in batches] == [pytest.approx(5e8)] * 3
    row = batches[2].summarise(bandwidth=1e11)
    assert row["share_of_memory_bound"] == pytest.approx(10_100 / 30e-6 / 1e9)
    assert row["share_of_arithmetic_bound"] == pytest.approx(10_100 / 30e-6 / 5e8)


def test_threads_that_share_only_the_larger_batches_raise_the_bound_with_the_rate():
    batches = [contend(100, 10e-6), contend(1000, 40e-6), contend(10_000, 190e-6)]  # one thread, two, two
    set_arithmetic_bounds(batches)
    assert batches[2].arithmetic_bound == pytest.approx(9000 / 150e-6)  # 900 / 30e-6 is less than its rate


@given(st.dictionaries(st.integers(1, 10**6), st.floats(1e-6, 1.0), min_size=2, max_size=6))
def test_no_batch_is_above_its_arithmetic_bound(walls):
    batches = [contend(rooms, wall) for rooms, wall in walls.items()]
    set_arithmetic_bounds(batches)
    assert all(one.summarise(bandwidth=1e11)["share_of_arithmetic_bound"] <= 1.0 + 1e-9 for one in batches)


@pytest.mark.nightly
def test_the_table_says_what_the_numbers_are(capsys):
    code, out, _ = run(capsys, *QUICK, "--scenes", "bit-flip", "--no-peers")
    assert code == 0
    assert "bit-flip" in out and "memory bound" in out and "resets included" in out and "CartPole" not in out


def test_velocities_are_drawn_within_their_bounds_on_both_sides_and_stepped():
    slow = Velocities(speed=0.5, turn_speed=0.2)
    batch = TensorRoom(Rooms(400, "paper-two-button"), velocities=slow)
    drawn = draw_uniformly(batch, torch.Generator().manual_seed(0))
    top = torch.tensor(slow.list_bounds(batch.layout.robot), dtype=torch.float64)
    assert drawn.shape == (400, 3) and (drawn.abs() <= top).all()
    assert (drawn.amin(0) < -0.9 * top).all() and (drawn.amax(0) > 0.9 * top).all()
    contender, primitives = (
        made[0][1]() for made in (list_makers(["paper-two-button"], [7], ["eager"], False,
                                              BatchSettings(1, "features", "cpu", glides)) for glides in (True, False)))
    assert contender.moved_bytes - primitives.moved_bytes >= 2 * 8, "three numbers for one, and a heading between steps"
    contender.measure(0.02)
    assert (contender.rooms, contender.engine) == (7, "eager") and contender.wall < 1.0


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--scenes", "cluter"], "did you mean 'clutter'"),
        (["--engines", "compile"], "did you mean 'compiled'"),
        (["--sizes", "0"], "sizes of at least 1"),
        (["--scenes", "push-block"], "physics"),
        (["--device", "cuda:77"], "device"),
    ],
)
def test_a_wrong_option_gets_one_clear_line(capsys, arguments, words):
    code, _, err = run(capsys, *QUICK, *arguments)
    assert code == 2
    assert words in err and len(err.strip().splitlines()) == 1
