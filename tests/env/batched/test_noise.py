"""Noise in tensors: the published answers of Philox, and the very numbers of the scalar rules."""

import pytest
import torch

from hrl_escape.env import noise
from hrl_escape.env.batched.rules import compute_noise
from hrl_escape.env.noise import draw_words, philox, scale_word

KNOWN = [  # kat_vectors of Random123, philox4x32 10 rounds
    ((0, 0, 0, 0), (0, 0), (0x6627E8D5, 0xE169C58D, 0xBC57AC4C, 0x9B00DBD8)),
    ((0xFFFFFFFF,) * 4, (0xFFFFFFFF,) * 2, (0x408F276D, 0x41C83B0E, 0xA20BC7C6, 0x6D5451FD)),
    (
        (0x243F6A88, 0x85A308D3, 0x13198A2E, 0x03707344),
        (0xA4093822, 0x299F31D0),
        (0xD16CFE09, 0x94FDCCEB, 0x5001E420, 0x24126EA1),
    ),
]


@pytest.mark.parametrize(("counter", "key", "expected"), KNOWN)
def test_philox_gives_the_published_answers(counter, key, expected):
    words = philox(tuple(torch.tensor([word]) for word in counter), tuple(torch.tensor([word]) for word in key))
    assert tuple(word.item() for word in words) == expected


def test_noise_is_that_of_the_scalar_rules():
    keys = [0, 1, 12345, 2**40 + 7, 2**63 - 1]
    primitives = list(range(200))
    key = torch.tensor(keys).repeat_interleave(len(primitives))
    normal, uniform = compute_noise(key, torch.tensor(primitives, dtype=torch.int32).repeat(len(keys)))
    expected = torch.tensor([noise.compute_noise(k, n) for k in keys for n in primitives], dtype=torch.float64)
    assert (normal - expected[:, 0]).abs().max() < 1e-14
    assert torch.equal(uniform, expected[:, 1])


def test_draws_of_an_episode_differ_from_its_noise_and_from_other_episodes():
    seeds = torch.arange(50).repeat_interleave(20)
    words = torch.stack(draw_words(seeds, torch.arange(20).repeat(50)))
    assert len(set(words.flatten().tolist())) > 0.999 * words.numel()
    nought = torch.zeros(20, dtype=torch.int64)
    noisy = philox((torch.arange(20), nought, nought, nought), (nought, nought))
    assert not set(torch.stack(noisy).flatten().tolist()) & set(words[:, :20].flatten().tolist())


def test_scaled_words_cover_their_range_evenly():
    words = torch.stack(draw_words(torch.arange(20_000), torch.zeros(20_000, dtype=torch.int64)))
    counts = torch.bincount(scale_word(words.flatten(), 7))
    assert len(counts) == 7
    assert (counts / counts.sum() - 1 / 7).abs().max() < 0.006
    assert scale_word(torch.tensor([0, 2**32 - 1]), 10_000).tolist() == [0, 9_999]
