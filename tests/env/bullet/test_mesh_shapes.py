"""Meshes for Bullet's eye: what is drawn leaves no memory behind."""

from __future__ import annotations

import gc
import resource
import sys
from pathlib import Path

import gymnasium
import pybullet
import pytest

from hrl_escape.env.bullet.cameras import create_mesh_shape
from hrl_escape.env.pictures.meshes import make_cylinder, make_prism

MESHES = [make_cylinder(1.0, 0.0, 1.0), make_prism([(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)], 0.0, 2.0)]


def measure_memory() -> float:
    """Resident memory of this process, MiB."""
    gc.collect()
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize() / 2**20


def test_shapes_leave_no_objects_behind():
    client = pybullet.connect(pybullet.DIRECT)
    try:
        for mesh in MESHES:
            create_mesh_shape(client, mesh, (1.0, 0.0, 0.0, 1.0))
        before = len(gc.get_objects()), sys.getallocatedblocks()
        for _ in range(50):
            for mesh in MESHES:
                create_mesh_shape(client, mesh, (1.0, 0.0, 0.0, 1.0))
        after = len(gc.get_objects()), sys.getallocatedblocks()
    finally:
        pybullet.disconnect(client)
    assert after[0] - before[0] < 20, "a list for each vertex would be 7,000"
    assert after[1] - before[1] < 200


@pytest.mark.slow
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads /proc")
def test_rendered_environments_leave_memory_as_it_was():
    def render(seed: int) -> None:
        env = gymnasium.make("hrl_escape/PaperTwoButton-v1", render_mode="rgb_array")
        env.reset(seed=seed)
        env.render()
        env.close()

    for seed in range(20):
        render(seed)
    before = measure_memory()
    for seed in range(200):
        render(seed)
    assert measure_memory() - before < 10, "a mebibyte an environment would be 200"
