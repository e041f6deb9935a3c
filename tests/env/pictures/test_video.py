"""Frames as files: they come back as they were, and failures are clear."""

import sys

import numpy as np
import pytest
from PIL import Image

from hrl_escape.env.pictures.video import save_picture, save_video
from hrl_escape.errors import FileWriteError, MissingExtraError, UnsupportedError

COLOURS = [(200, 30, 40), (40, 160, 60), (30, 60, 200), (240, 200, 40)]


def make_frames(height=48, width=64):
    """Plain frames of different colours with a white square that moves."""
    frames = []
    for number, colour in enumerate(COLOURS):
        frame = np.full((height, width, 3), colour, dtype=np.uint8)
        frame[10:20, 10 * number : 10 * number + 10] = 255
        frames.append(frame)
    return frames


def test_pictures_come_back_exactly(tmp_path):
    frame = make_frames()[0]
    save_picture(tmp_path / "frame.png", frame)
    assert np.array_equal(np.asarray(Image.open(tmp_path / "frame.png")), frame)


def test_gifs_hold_every_frame_with_its_colours_and_time(tmp_path):
    frames = make_frames()
    save_video(tmp_path / "video.gif", iter(frames), frames_per_second=5)
    with Image.open(tmp_path / "video.gif") as gif:
        assert gif.n_frames == len(frames) and gif.info["loop"] == 0
        for number, frame in enumerate(frames):
            gif.seek(number)
            assert gif.info["duration"] == 200
            assert np.abs(np.asarray(gif.convert("RGB")).astype(int) - frame).max() <= 3


def test_mp4s_hold_every_frame(tmp_path):
    imageio_ffmpeg = pytest.importorskip("imageio_ffmpeg")
    frames = make_frames(height=49, width=65)  # odd sizes lose their last row and column
    save_video(tmp_path / "video.mp4", iter(frames), frames_per_second=5)
    reader = imageio_ffmpeg.read_frames(str(tmp_path / "video.mp4"))
    about = next(reader)
    read = [np.frombuffer(frame, dtype=np.uint8).reshape(48, 64, 3) for frame in reader]
    assert about["size"] == (64, 48) and about["fps"] == 5 and len(read) == len(frames)
    for number, frame in enumerate(read):
        assert np.abs(frame[40, 50].astype(int) - COLOURS[number]).max() < 30


def test_mp4_without_its_extra_names_the_extra(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(MissingExtraError, match=r"\.\[video\]"):
        save_video(tmp_path / "video.mp4", make_frames())
    save_video(tmp_path / "video.gif", make_frames())


def test_clear_errors(tmp_path):
    with pytest.raises(UnsupportedError, match=r"video\.avi.*\.gif or \.mp4"):
        save_video(tmp_path / "video.avi", make_frames())
    with pytest.raises(UnsupportedError, match="no frames"):
        save_video(tmp_path / "video.gif", [])
    with pytest.raises(UnsupportedError, match=r"\.png"):
        save_picture(tmp_path / "frame.jpg", make_frames()[0])
    (tmp_path / "file").touch()
    with pytest.raises(FileWriteError):
        save_video(tmp_path / "file" / "video.gif", make_frames())
