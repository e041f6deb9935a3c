"""The table of published recordings takes recordings that are what their names say, and those of the package first."""

from __future__ import annotations

import dataclasses

import pytest

from benchmarks.recordings import read_recordings, write_line
from hrl_escape.data.catalogue import RECORDING_SIZES
from hrl_escape.data.published import read_published
from hrl_escape.data.recording import save_recording
from hrl_escape.errors import VerificationError
from hrl_escape.files import read_toml
from tests.data.small import make_recording

NAME = "pair-play-1m-v1"


@pytest.mark.nightly
def test_a_recording_of_its_size_and_name_is_published_and_the_package_wins(tmp_path, monkeypatch):
    monkeypatch.setitem(RECORDING_SIZES, "1m", 2_000)
    recording = dataclasses.replace(make_recording(), about={**make_recording().about, "name": NAME})
    save_recording(tmp_path / f"{NAME}.npz", recording)
    save_recording(tmp_path / "pair-play-v1.npz", make_recording())  # a trial of one that comes with the package
    found, published = read_recordings(tmp_path), read_published()
    assert found.pop(NAME).content == recording.content
    assert found == {name: known for name, known in published.items() if name in found} and len(found) == 48
    (table := tmp_path / "table.toml").write_text(write_line("pair-play-v1", found["pair-play-v1"]))
    assert read_toml(table, "table") == {"pair-play-v1": dataclasses.asdict(published["pair-play-v1"])}


@pytest.mark.parametrize(("name", "size"), [(NAME, 3_000), ("pair-noisy-1m-v1", 2_000)])
def test_a_trial_and_a_recording_of_another_name_are_refused(tmp_path, monkeypatch, name, size):
    monkeypatch.setitem(RECORDING_SIZES, "1m", size)
    renamed = dataclasses.replace(make_recording(), about={**make_recording().about, "name": NAME})
    save_recording(tmp_path / f"{name}.npz", renamed)
    with pytest.raises(VerificationError, match=f"{name}.npz holds 2,[0-9]+ primitives of {NAME}"):
        read_recordings(tmp_path)
