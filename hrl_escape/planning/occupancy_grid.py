"""Occupancy grids as ROS writes them: a YAML file that names an image, read by the rules of nav2's `map_io`.

The rules are those of `nav2_map_server/src/map_io.cpp` (navigation2, main branch of 2025): grey values become
occupancies of -1 (unknown) or 0 to 100, in mode `trinary`, `scale` or `raw`.
"""

from __future__ import annotations

import dataclasses
import io
import math
import warnings
from pathlib import Path
from typing import Any, Literal

import numpy as np
import yaml
from numpy.typing import NDArray
from PIL import Image

from hrl_escape.errors import FileReadError, show_value
from hrl_escape.files import read_bytes, read_text

MODES = ("trinary", "scale", "raw")
LARGEST_YAML = 2**16
"""Bytes of the largest YAML file of a map, 64 KiB."""
LARGEST_IMAGE = 2**26
"""Bytes of the largest image of a map, 64 MiB."""
MOST_MAP_CELLS = 25_000_000
"""Cells of the largest map, such as 5,000 x 5,000."""
IMAGE_FORMATS = ("PNG", "PPM", "BMP")
"""Image formats that nav2 recommends, by Pillow's names; `PPM` includes PGM."""
_UNKNOWN, _OCCUPIED = -1, 100
_LUMA = np.array([0.212656, 0.715158, 0.072186])  # Rec. 709, as in GraphicsMagick's greyscale


@dataclasses.dataclass(frozen=True, eq=False)
class OccupancyGrid:
    """Occupancies of the cells of a map.

    Attributes:
        values: -1 for unknown, else 0 (free) to 100 (occupied); int8, shape (rows along y, columns along x), the
            row with the least y first.
        resolution: side of a cell, m.
        origin: x and y of the corner with the least x and y, in the map's frame, m.
        most_free: largest value that counts as free: 0, or in mode `raw` 100 times `free_thresh`.
        least_occupied: least value that counts as occupied: 100, or in mode `raw` 100 times `occupied_thresh`.
    """

    values: NDArray[np.int8]
    resolution: float
    origin: tuple[float, float]
    most_free: float
    least_occupied: float

    def find_solid(self, unknown_is_free: bool) -> NDArray[np.bool_]:
        """Return the cells to keep clear of, bool, shape as `values`.

        Cells between free and occupied are treated as unknown.
        """
        if unknown_is_free:
            return self.values >= self.least_occupied
        return (self.values < 0) | (self.values > self.most_free)


def read_occupancy_grid(path: str | Path) -> OccupancyGrid:
    """Read a map's YAML file and its image.

    Args:
        path: the YAML file, with the keys `image`, `resolution`, `origin`, `negate`, `occupied_thresh`,
            `free_thresh` and optionally `mode`.

    Raises:
        FileReadError: a file is missing, too large or of another kind, or a key is missing or has a value that
            nav2 does not accept.
    """
    path = Path(path)
    about = _read_keys(path)
    mode = about.get("mode", "trinary")
    if mode not in MODES:
        raise _refuse(path, "mode", mode, f"one of {', '.join(MODES)}")
    resolution = _read_number(path, about, "resolution")
    if not resolution > 0.0:
        raise _refuse(path, "resolution", about["resolution"], "a number of metres above 0")
    origin = about.get("origin")
    if not isinstance(origin, list) or len(origin) != 3:
        raise _refuse(path, "origin", origin, "a list of x, y and yaw")
    x, y, yaw = (_read_number(path, {"origin": number}, "origin") for number in origin)
    if abs(math.remainder(yaw, math.tau)) > 1e-9:
        raise _refuse(path, "origin", origin, "a yaw of 0: turn the image and the origin instead")
    free, occupied = (_read_number(path, about, key) for key in ("free_thresh", "occupied_thresh"))
    if not 0.0 <= free < occupied <= 1.0:
        raise _refuse(path, "free_thresh, occupied_thresh", (free, occupied),
                      "two numbers with 0 <= free_thresh < occupied_thresh <= 1")
    negate = about.get("negate")
    if not isinstance(negate, (bool, int)):
        raise _refuse(path, "negate", negate, "0, 1, true or false")
    image = about.get("image")
    if not isinstance(image, str) or not image:
        raise _refuse(path, "image", image, "the name of an image file")
    grey, is_opaque = _read_image(path.parent / image)
    if mode == "raw":
        values = np.where(grey > _OCCUPIED, _UNKNOWN, grey.astype(np.int16)).astype(np.int8)
        return OccupancyGrid(values[::-1], resolution, (x, y), 100 * free, 100 * occupied)
    values = _interpret(grey, is_opaque, mode, bool(negate), free, occupied)
    return OccupancyGrid(values[::-1], resolution, (x, y), 0, _OCCUPIED)


def _interpret(grey: NDArray[np.uint8], is_opaque: NDArray[np.bool_], mode: Literal["trinary", "scale"], negate: bool,
               free: float, occupied: float) -> NDArray[np.int8]:
    shade = grey.astype(np.float32) / np.float32(255)
    occupancy = shade if negate else np.float32(1) - shade
    values = np.full(grey.shape, _UNKNOWN, dtype=np.int8)
    if mode == "scale":
        between = np.round((occupancy - free) / (occupied - free) * 100)
        values = np.where((occupancy > free) & (occupancy < occupied), between, values).astype(np.int8)
    values[occupancy >= occupied] = _OCCUPIED
    values[occupancy <= free] = 0
    values[~is_opaque] = _UNKNOWN
    return values


def _read_keys(path: Path) -> dict[str, Any]:
    try:
        about = yaml.safe_load(read_text(path, "map", LARGEST_YAML))
    except (yaml.YAMLError, RecursionError, ValueError) as error:
        first = (str(error).splitlines() or [type(error).__name__])[0]
        raise FileReadError(f"{path}: this map is not YAML: {first}") from None
    if not isinstance(about, dict):
        raise FileReadError(f"{path}: this map is not a table of `image`, `resolution`, `origin` and so on, as ROS's "
                            "map_server writes it")
    missing = [key for key in ("image", "resolution", "origin", "negate", "occupied_thresh", "free_thresh")
               if key not in about]
    if missing:
        raise FileReadError(f"{path}: this map lacks {', '.join(missing)}; nav2's map_server requires them")
    return about


def _read_number(path: Path, about: dict[str, Any], key: str) -> float:
    try:
        if isinstance(about[key], bool):
            raise TypeError
        value = float(about[key])
    except (TypeError, ValueError, OverflowError):
        raise _refuse(path, key, about[key], "a finite number") from None
    if not math.isfinite(value):
        raise _refuse(path, key, about[key], "a finite number")
    return value


def _refuse(path: Path, key: str, value: Any, valid: str) -> FileReadError:
    return FileReadError(f"{path}: `{key}` must be {valid}, got {show_value(value)}")


def _read_image(path: Path) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
    """Return grey values of 8 bits, and where the image is opaque; both (rows, columns), the top row first."""
    content = read_bytes(path, "map image", LARGEST_IMAGE)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)  # the size is checked here
            image = Image.open(io.BytesIO(content), formats=IMAGE_FORMATS)
        with image:
            if image.width * image.height > MOST_MAP_CELLS:
                raise FileReadError(f"{path}: this map image has {image.width} x {image.height} pixels; at most "
                                    f"{MOST_MAP_CELLS:,} are read")
            image.load()
            if image.mode in ("P", "PA"):
                image = image.convert("RGBA" if "transparency" in image.info else "RGB")
            elif image.mode == "1":
                image = image.convert("L")
            pixels = np.asarray(image)
            mode = image.mode
    except FileReadError:
        raise
    except Exception as error:  # Pillow's readers raise many kinds for damaged files
        raise FileReadError(f"{path}: this map image is damaged or not PNG, PGM, PPM or BMP: "
                            f"{type(error).__name__}: {error}") from None
    if mode.startswith("I"):  # 16 bits
        pixels = np.round(pixels.astype(np.float64) / 257.0)
    channels = pixels[..., None] if pixels.ndim == 2 else pixels
    is_opaque = channels[..., -1] == 255 if mode in ("LA", "RGBA") else np.ones(channels.shape[:2], dtype=bool)
    colours = channels[..., :3] if channels.shape[-1] >= 3 else channels[..., :1]
    grey = colours @ _LUMA if colours.shape[-1] == 3 else colours[..., 0]
    return np.round(grey).clip(0, 255).astype(np.uint8), is_opaque
