"""Noise: Philox against its authors' known answers, and the distribution it is turned into."""

import math

import numpy as np
import pytest

from hrl_escape.env.noise import MASK, NOISE_PURPOSE, compute_noise, philox


@pytest.mark.parametrize(
    ("counter", "key", "expected"),
    [  # kat_vectors of Random123, philox4x32 10 rounds
        ((0, 0, 0, 0), (0, 0), (0x6627E8D5, 0xE169C58D, 0xBC57AC4C, 0x9B00DBD8)),
        ((0xFFFFFFFF,) * 4, (0xFFFFFFFF,) * 2, (0x408F276D, 0x41C83B0E, 0xA20BC7C6, 0x6D5451FD)),
        (
            (0x243F6A88, 0x85A308D3, 0x13198A2E, 0x03707344),
            (0xA4093822, 0x299F31D0),
            (0xD16CFE09, 0x94FDCCEB, 0x5001E420, 0x24126EA1),
        ),
    ],
)
def test_philox_gives_the_published_answers(counter, key, expected):
    assert philox(counter, key) == expected


def test_noise_is_standard_normal_and_uniform():
    drawn = np.array([compute_noise(12345, n) for n in range(20_000)])
    normal, uniform = drawn.T
    assert abs(normal.mean()) < 0.03
    assert abs(normal.std() - 1) < 0.02
    assert abs((normal**4).mean() - 3) < 0.25
    assert abs(uniform.mean() - 0.5) < 0.01
    assert uniform.min() > 0
    assert uniform.max() < 1
    assert abs(np.corrcoef(normal, uniform)[0, 1]) < 0.03


def test_noise_differs_between_episodes_and_primitives():
    assert len({compute_noise(key, n) for key in (0, 1, 2**40, 2**62) for n in (0, 1, 2**33)}) == 12


@pytest.mark.parametrize("first", [0, 2**32 - 70, 2**40])
def test_noise_drawn_for_many_primitives_at_once_is_that_of_each_alone(first):
    for key in (7, 2**63 - 1):
        for n in range(first, first + 300, 7):
            a, b, c, _ = philox((n & MASK, n >> 32, NOISE_PURPOSE, 0), (key & MASK, key >> 32))
            normal, uniform = compute_noise(key, n)
            assert uniform == (c + 0.5) / 2**32
            size, angle = math.sqrt(-2.0 * math.log((a + 0.5) / 2**32)), 2.0 * math.pi * ((b + 0.5) / 2**32)
            assert normal == pytest.approx(size * math.cos(angle), rel=1e-12, abs=1e-12)
