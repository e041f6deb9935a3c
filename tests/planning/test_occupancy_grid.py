"""Occupancy grids, cell by cell against nav2's `map_io` rules as a reference written pixel by pixel."""

from __future__ import annotations

import os

import numpy as np
import pytest
from PIL import Image

from hrl_escape.errors import FileReadError
from hrl_escape.planning.occupancy_grid import read_occupancy_grid

ABOUT = {"image": "map.png", "resolution": 0.05, "origin": [-3.0, 2.0, 0.0], "negate": 0, "occupied_thresh": 0.65,
         "free_thresh": 0.196}


def write(folder, picture=None, **changes):
    if picture is not None:
        picture.save(folder / str(changes.get("image", "map.png")))
    about = {key: value for key, value in (ABOUT | changes).items() if value is not None}
    (folder / "map.yaml").write_text("".join(f"{key}: {value}\n" for key, value in about.items()))
    return folder / "map.yaml"


def interpret(grey, alpha, mode, negate, free, occupied):
    """Value of one pixel of 8 bits, in the order of `loadMapFromFile`."""
    if mode == "raw":
        return grey if grey <= 100 else -1
    occupancy = grey / 255 if negate else 1 - grey / 255
    value = -1
    if occupancy >= occupied:
        value = 100
    elif occupancy <= free:
        value = 0
    elif mode == "scale":
        value = round((occupancy - free) / (occupied - free) * 100)
    return value if alpha == 255 else -1


@pytest.mark.parametrize("mode", ["trinary", "scale", "raw"])
@pytest.mark.parametrize("negate", [0, 1, True, False])
@pytest.mark.parametrize("thresholds", [(0.196, 0.65), (0.0, 1.0), (0.25, 0.5)])
def test_every_grey_and_alpha_is_read_by_the_rules_of_nav2(tmp_path, mode, negate, thresholds):
    grey = np.tile(np.arange(256, dtype=np.uint8), (3, 1))
    alpha = np.repeat(np.array([[255], [254], [0]], dtype=np.uint8), 256, axis=1)
    path = write(tmp_path, Image.merge("LA", [Image.fromarray(grey), Image.fromarray(alpha)]), mode=mode,
                 negate=negate, free_thresh=thresholds[0], occupied_thresh=thresholds[1])
    values = read_occupancy_grid(path).values
    expected = np.array([[interpret(int(g), int(a), mode, bool(negate), *thresholds)
                          for g, a in zip(*rows, strict=True)] for rows in zip(grey, alpha, strict=True)])[::-1]
    assert values.dtype == np.int8 and (np.abs(values - expected) <= (mode == "scale")).all()
    assert ((values == expected) | ((expected > 0) & (expected < 100))).all(), "rounding of float32 at most"


@pytest.mark.parametrize("kind", ["png16", "pgm16", "pgm100", "ascii", "palette", "bmp", "ppm", "bit"])
def test_every_bit_depth_and_format_gives_the_same_cells(tmp_path, kind):
    levels = np.array([0, 255] if kind == "bit" else [0, 205, 254, 255], dtype=np.uint8)
    grey = levels[np.random.default_rng(0).integers(0, len(levels), (12, 16))]
    image = Image.fromarray(grey)
    name = {"pgm16": "map.pgm", "pgm100": "map.pgm", "ascii": "map.pgm", "bmp": "map.bmp", "ppm": "map.ppm"}.get(
        kind, "map.png")
    if kind == "png16":
        image = Image.fromarray(grey.astype(np.uint16) * 257)
    elif kind in ("palette", "bit"):
        image = image.convert("P" if kind == "palette" else "1")
    elif kind in ("bmp", "ppm"):
        image = image.convert("RGB")
    path = write(tmp_path, None if name.endswith(".pgm") else image, image=name)
    if kind == "pgm16":
        (tmp_path / name).write_bytes(b"P5\n16 12\n65535\n" + (grey.astype(">u2") * 257).tobytes())
    elif kind == "pgm100":
        (tmp_path / name).write_bytes(b"P5\n# comment\n16 12\n100\n" + bytes(np.round(grey / 2.55).astype(np.uint8)))
    elif kind == "ascii":
        (tmp_path / name).write_text("P2\n16 12\n255\n" + "\n".join(" ".join(map(str, row)) for row in grey))
    expected = [[interpret(int(g), 255, "trinary", False, 0.196, 0.65) for g in row] for row in grey[::-1]]
    assert (read_occupancy_grid(path).values == expected).all()


def test_cells_between_the_thresholds_are_kept_clear_of_unless_unknown_is_free(tmp_path):
    grey = np.array([[255, 200, 128, 90, 0]], dtype=np.uint8)
    grid = read_occupancy_grid(write(tmp_path, Image.fromarray(grey), mode="scale"))
    assert grid.find_solid(unknown_is_free=False).tolist() == [[False, True, True, True, True]]
    assert grid.find_solid(unknown_is_free=True).tolist() == [[False, False, False, False, True]]
    assert grid.origin == (-3.0, 2.0) and grid.resolution == 0.05


@pytest.mark.parametrize(("changes", "match"), [
    ({"mode": "Foo"}, "`mode` must be one of"), ({"resolution": 0}, "`resolution`"), ({"resolution": ".nan"}, "finite"),
    ({"resolution": "fine"}, "finite number, got 'fine'"), ({"origin": "[0, 0]"}, "`origin` must be a list"),
    ({"origin": "[0, 0, .nan]"}, "finite"), ({"origin": "[0, 0, 0.5]"}, "yaw of 0"),
    ({"free_thresh": ".nan"}, "finite"), ({"free_thresh": 7}, "0 <= free_thresh"),
    ({"free_thresh": 0.7}, "0 <= free_thresh"), ({"image": "none.png"}, "no such"),
    ({"image": '""'}, "name of an image"), ({"negate": "[1]"}, "`negate`"), ({"negate": None}, "lacks negate"),
    ({"occupied_thresh": True}, "finite number"), ({"image": "/dev/zero"}, "device"),
])
def test_what_nav2_refuses_is_refused_by_the_name_of_the_key(tmp_path, changes, match):
    with pytest.raises(FileReadError, match=match):
        read_occupancy_grid(write(tmp_path, Image.fromarray(np.zeros((2, 2), np.uint8)), **changes)
                            if "image" not in changes else write(tmp_path, **changes))


def test_a_full_turn_of_the_origin_is_none(tmp_path):
    path = write(tmp_path, Image.fromarray(np.zeros((2, 2), np.uint8)), origin=[1.0, 2.0, 2 * np.pi])
    assert read_occupancy_grid(path).origin == (1.0, 2.0)


def test_hostile_files_are_refused_early(tmp_path):
    path = write(tmp_path)
    os.mkfifo(tmp_path / "map.png")
    with pytest.raises(FileReadError, match="pipe"):
        read_occupancy_grid(path)
    (tmp_path / "map.png").unlink()
    for content, match in ((b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 9 9\n", "damaged or not PNG"),
                           (b"P5\n13000 13000\n255\n", "13000 x 13000 pixels"),
                           (b"P5\n16 12\n255\n0000", "damaged"), (b"hi", "damaged or not PNG")):
        (tmp_path / "map.png").write_bytes(content)
        with pytest.raises(FileReadError, match=match):
            read_occupancy_grid(path)
    for text, match in (("- 1\n", "not a table"), ("", "not a table"), ("a: [" * 2000, "not YAML"),
                        ("# " + "x" * 70_000, "65,536"), ("a: &a [x, x]\nb: [*a, *a]\n", "lacks image")):
        path.write_text(text)
        with pytest.raises(FileReadError, match=match):
            read_occupancy_grid(path)
