"""Many rows through a perceptron, block by block: outputs and gradients are those of its layers in turn."""

from __future__ import annotations

import pytest
import torch
from torch import nn

from hrl_escape.agents.components.networks import BLOCK_ROWS, Network


@pytest.mark.parametrize("activation", [nn.Tanh, nn.ReLU])
@pytest.mark.parametrize("rows", [BLOCK_ROWS, BLOCK_ROWS + 1, 3 * BLOCK_ROWS + 5])
def test_rows_in_blocks_give_the_outputs_and_gradients_of_plain_layers(activation, rows):
    generator = torch.Generator().manual_seed(rows)
    sizes = (7, 16, 9, 3)
    layers = [nn.utils.skip_init(nn.Linear, *pair) for pair in zip(sizes, sizes[1:], strict=False)]
    for layer in layers:
        for parameter in layer.parameters():
            nn.init.normal_(parameter, std=0.5, generator=generator)
    network = Network(layers[0], activation(), layers[1], activation(), layers[2])
    seen = torch.randn((rows, 7), generator=generator)
    weights = torch.randn((rows, 3), generator=generator)
    results = []
    for compute in (network, lambda x: nn.Sequential.forward(network, x)):
        network.gradient.zero_()
        inputs = seen.clone().requires_grad_()
        outputs = compute(inputs)
        (outputs.square() * weights).sum().backward()
        results.append((outputs.detach(), inputs.grad, network.gradient.clone()))
    for ours, plain in zip(*results, strict=True):
        assert torch.allclose(ours, plain, rtol=1e-4, atol=1e-4 * float(plain.abs().max()))
    with torch.no_grad():
        assert torch.equal(network(seen), results[0][0])
    assert not network(seen[:0]).numel()
