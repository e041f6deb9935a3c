"""The check of a folder of robots and maps: what it counts."""

from __future__ import annotations

import numpy as np
import pytest
from PIL import Image

from benchmarks.robots import Args, run
from tests.planning.arm.robots import make_arm


@pytest.mark.nightly
def test_files_that_are_read_and_refused_are_counted(tmp_path, capsys):
    (tmp_path / "arm.urdf").write_text(make_arm())
    (tmp_path / "arm.srdf").write_text('<robot name="r"><group_state name="a" group="g"><joint name="turn" value="1"/>'
                                       "</group_state></robot>")
    (tmp_path / "broken.urdf").write_text(make_arm('<ellipsoid radii="1 1 1"/>').replace('name="r"', 'name="b"'))
    Image.fromarray(np.zeros((3, 4), dtype=np.uint8)).save(tmp_path / "map.pgm")
    (tmp_path / "map.yaml").write_text("image: map.pgm\nresolution: 0.1\norigin: [0, 0, 0]\nnegate: 0\n"
                                       "occupied_thresh: 0.65\nfree_thresh: 0.2\n")
    assert run(Args(tmp_path)) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[-1] == "{'read': 3, 'refused': 1}"
    assert "'postures': 1" in lines[0] and "'plan': '2 points'" in lines[1]
    assert "collision shape of link 'boom' is <ellipsoid>" in lines[2] and "'solid': 12" in lines[3]
