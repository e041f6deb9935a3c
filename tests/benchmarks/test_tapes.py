"""The table of published tapes takes tapes that are what their names say, and those of the package first."""

from __future__ import annotations

import dataclasses

import pytest

from benchmarks.tapes import read_tapes, write_line
from hrl_escape.data.catalogue import TAPE_SIZES
from hrl_escape.data.published import read_published
from hrl_escape.data.tape import save_tape
from hrl_escape.errors import VerificationError
from hrl_escape.files import read_toml
from tests.data.small import make_tape

NAME = "pair-play-1m-v1"


def test_a_recording_of_its_size_and_name_is_published_and_the_package_wins(tmp_path, monkeypatch):
    monkeypatch.setitem(TAPE_SIZES, "1m", 2_000)
    tape = dataclasses.replace(make_tape(), about={**make_tape().about, "name": NAME})
    save_tape(tmp_path / f"{NAME}.npz", tape)
    save_tape(tmp_path / "pair-play-v1.npz", make_tape())  # a trial of one that comes with the package
    found, published = read_tapes(tmp_path), read_published()
    assert found.pop(NAME).content == tape.content
    assert found == {name: known for name, known in published.items() if name in found} and len(found) == 48
    (table := tmp_path / "table.toml").write_text(write_line("pair-play-v1", found["pair-play-v1"]))
    assert read_toml(table, "table") == {"pair-play-v1": dataclasses.asdict(published["pair-play-v1"])}


@pytest.mark.parametrize(("name", "size"), [(NAME, 3_000), ("pair-noisy-1m-v1", 2_000)])
def test_a_trial_and_a_tape_of_another_name_are_refused(tmp_path, monkeypatch, name, size):
    monkeypatch.setitem(TAPE_SIZES, "1m", size)
    save_tape(tmp_path / f"{name}.npz", dataclasses.replace(make_tape(), about={**make_tape().about, "name": NAME}))
    with pytest.raises(VerificationError, match=f"{name}.npz holds 2,[0-9]+ primitives of {NAME}"):
        read_tapes(tmp_path)
