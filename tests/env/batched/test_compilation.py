"""Compiled steps: nested arguments and results, what is handed on, and refusals."""

from typing import NamedTuple

import pytest
import torch
from torch import Tensor

from hrl_escape.env.batched.compilation import CompiledStep
from hrl_escape.errors import BatchError


class Pair(NamedTuple):
    left: Tensor
    right: Tensor


def exchange(shifts: dict[str, Tensor], pair: Pair) -> tuple[Pair, dict[str, Tensor], None]:
    return Pair(pair.right - shifts["by"], pair.left), {"is_less": pair.left < pair.right}, None


@pytest.mark.nightly
def test_a_compiled_step_returns_what_the_function_returns_and_hands_on_the_same_tensors():
    shifts, ones = {"by": torch.tensor([5.0])}, torch.ones(7)
    run = CompiledStep(exchange, "cpu", 1).bind(shifts)
    first, flags, none = run(Pair(ones, ones))  # one tensor for two: the kernel must not take them for the same
    assert first.left.tolist() == [-4.0] * 7 and first.right is ones
    assert flags["is_less"].dtype == torch.bool and not flags["is_less"].any() and none is None
    left, right = torch.arange(7.0), torch.full((7,), 3.0)
    (swapped, flags, _), (expected, also, _) = run(Pair(left, right)), exchange(shifts, Pair(left, right))
    assert torch.equal(swapped.left, expected.left) and swapped.right is left
    assert torch.equal(flags["is_less"], also["is_less"]) and flags["is_less"].any()
    strided = torch.arange(14.0)[::2]
    assert torch.equal(run(Pair(left, strided))[0].left, strided - 5.0)
    with pytest.raises(BatchError, match=r"shape \(7,\), torch.float32"):
        run(Pair(left, right.to(torch.float64)))
    with pytest.raises(BatchError, match=r"shape \(7,\)"):
        run(Pair(left[:6], right))
