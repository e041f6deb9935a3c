"""Frames as files: PNG pictures, GIF animations (always) and MP4 videos (extra `video`).

A frame is an array (height, width, 3), uint8, RGB, from any camera or map. Files are written atomically. This module
does not render.
"""

from __future__ import annotations

import io
import itertools
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from hrl_escape.errors import FileWriteError, MissingExtraError, UnsupportedError
from hrl_escape.figures import VIDEO_FORMATS
from hrl_escape.files import temporary_folder, write_bytes

Picture = NDArray[np.uint8]


def save_picture(path: str | Path, frame: Picture) -> None:
    """Write one frame as PNG.

    Raises:
        UnsupportedError: `path` does not end in `.png`.
        FileWriteError: the file could not be written.
    """
    if Path(path).suffix.lower() != ".png":
        raise UnsupportedError(f"{path}: the name of a picture must end in .png")
    content = io.BytesIO()
    Image.fromarray(frame).save(content, "PNG")
    write_bytes(path, content.getvalue())


def save_video(path: str | Path, frames: Iterable[Picture], frames_per_second: float = 10.0) -> None:
    """Write an animation, as GIF or MP4 by the ending of `path`.

    Args:
        path: file that ends in `.gif` or `.mp4`.
        frames: at least one frame, all of one size; consumed one at a time.
        frames_per_second: playing speed; GIF rounds frames to hundredths of a second.

    Raises:
        UnsupportedError: another ending, or no frames.
        MissingExtraError: MP4 without the extra `video`.
        FileWriteError: the file could not be written.
    """
    kind = Path(path).suffix.lower().lstrip(".")
    if kind not in VIDEO_FORMATS:
        raise UnsupportedError(f"{path}: the name of a video must end in "
                               f"{' or '.join('.' + f for f in VIDEO_FORMATS)}")
    stream = iter(frames)
    first = next(stream, None)
    if first is None:
        raise UnsupportedError(f"{path}: there are no frames to write")
    make = _make_gif if kind == "gif" else _make_mp4
    write_bytes(path, make(first, stream, frames_per_second))


def _make_gif(first: Picture, rest: Iterable[Picture], rate: float) -> bytes:
    content = io.BytesIO()
    # Flat colours without dithering keep files small and edges stable.
    images = (Image.fromarray(frame).quantize(256, Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE)
              for frame in itertools.chain([first], rest))
    next(images).save(content, "GIF", save_all=True, append_images=images, duration=round(1000 / rate), loop=0)
    return content.getvalue()


def _make_mp4(first: Picture, rest: Iterable[Picture], rate: float) -> bytes:
    try:
        import imageio_ffmpeg  # optional
    except ImportError:
        raise MissingExtraError("imageio-ffmpeg", "video", "Writing MP4 (GIF needs no extra)") from None
    even = np.s_[: first.shape[0] // 2 * 2, : first.shape[1] // 2 * 2]  # H.264 requires even sizes
    with temporary_folder() as folder:
        path = folder / "video.mp4"
        settings: dict[str, Any] = {"fps": rate, "macro_block_size": 2, "quality": 8, "ffmpeg_log_level": "error"}
        writer = imageio_ffmpeg.write_frames(str(path), first[even].shape[1::-1], **settings)
        writer.send(None)
        try:
            for frame in itertools.chain([first], rest):
                writer.send(np.ascontiguousarray(frame[even]))
        except OSError as error:
            raise FileWriteError(f"FFmpeg could not write the video: {error}") from error
        finally:
            writer.close()
        return path.read_bytes()
