"""Endings of pictures and videos, which can be checked before anything that draws is loaded."""

from __future__ import annotations

from pathlib import Path

from hrl_escape.errors import UnsupportedError

__all__ = ["FORMATS", "VIDEO_FORMATS", "check_picture_name"]

FORMATS = ("png", "svg", "pdf")
VIDEO_FORMATS = ("gif", "mp4")


def check_picture_name(path: Path, *others: str) -> None:
    """Check the ending of a file that is to hold a map or a video.

    Args:
        path: the file.
        others: further endings that will do.

    Raises:
        UnsupportedError: it is neither of these nor of `FORMATS` nor of `VIDEO_FORMATS`.
    """
    endings = (*FORMATS, *VIDEO_FORMATS, *others)
    if path.suffix.lower().lstrip(".") not in endings:
        raise UnsupportedError(f"{path}: a picture's name must end in {', '.join(f'.{each}' for each in endings)}")
