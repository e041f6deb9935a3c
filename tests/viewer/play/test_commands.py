"""Commands of manual mode: their effect on the episode and the message that they leave."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest

from hrl_escape.viewer.play.commands import PERSONAL_BESTS, Command, carry_out
from hrl_escape.viewer.play.episode import Episode, load_episode


@pytest.fixture(autouse=True)
def own_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def act(episode: Episode, name: str, best: float | None = None) -> str:
    return carry_out(Command("act", episode.names.index(name)), episode, Path(), best)


def test_a_meta_action_tells_its_length_and_the_button_it_pressed(two_buttons):
    message = act(Episode(two_buttons), "press-button-1")
    assert message.startswith("press-button-1 (") and message.endswith(" primitives), pressed button-1")


def test_undo_and_reset_change_the_episode_and_say_so(two_buttons, tmp_path):
    episode = Episode(two_buttons)
    assert carry_out(Command("undo"), episode, tmp_path) == "There is nothing to undo"
    assert act(episode, "forward") == "forward"
    assert carry_out(Command("undo"), episode, tmp_path) == "forward taken back" and episode.steps == []
    act(episode, "forward")
    assert carry_out(Command("reset"), episode, tmp_path) == "Started again" and episode.steps == []


@pytest.mark.parametrize(("best", "praise"), [
    (None, "."), (91.0, ": the best known!"), (93.0, ", 2 short of the best known."),
    (90.0, ": 1 better than the best known!"),
])
def test_an_escape_is_held_against_the_best_known_return(one_button, best, praise):
    episode = Episode(one_button)
    messages = [act(episode, "strafe-left", best) for _ in range(9)]
    assert messages[-1] == f"Escaped with a return of 91{praise} Your first escape from this room"
    assert act(episode, "forward").startswith("This episode is over")
    assert len(episode.steps) == 9


def test_a_masked_meta_action_says_that_it_cannot_start(clutter):
    episode = Episode(clutter)
    assert act(episode, "go-to-exit") == "go-to-exit cannot start here" and episode.moves == []


def test_saving_names_the_file(two_buttons, tmp_path):
    episode = Episode(two_buttons)
    act(episode, "forward")
    message = carry_out(Command("save"), episode, tmp_path)
    (file,) = tmp_path.iterdir()
    assert message == f"Saved as {file}" and "-1-primitives-" in file.name
    assert load_episode(file).primitives == episode.to_saved().primitives


def test_two_episodes_of_equal_length_have_files_of_their_own(two_buttons, tmp_path):
    for name in ("forward", "turn-left", "turn-left"):
        episode = Episode(two_buttons)
        act(episode, name)
        carry_out(Command("save"), episode, tmp_path)
    files = list(tmp_path.iterdir())
    assert len(files) == 2, "the same episode twice is one file"
    assert len({load_episode(file).primitives for file in files}) == 2


def test_a_room_whose_name_is_a_path_is_saved_in_the_folder(two_buttons, tmp_path):
    for name in ("../../up", "a/b", "nul\0", "x" * 300):
        episode = Episode(dataclasses.replace(two_buttons, name=name))
        act(episode, "forward")
        carry_out(Command("save"), episode, tmp_path / "here")
    assert list(tmp_path.iterdir()) == [tmp_path / "here"] and len(list((tmp_path / "here").iterdir())) == 4


def test_a_personal_best_is_kept_for_each_room_and_apart_where_the_graph_is_hidden(one_button):
    def escape(detour: int, is_hidden: bool = False) -> str:
        episode = Episode(one_button, is_hidden=is_hidden)
        for name in ["turn-left", "turn-right"] * detour:
            act(episode, name)
        return [act(episode, "strafe-left") for _ in range(9)][-1].split(". ")[1]

    assert [escape(2), escape(1), escape(2), escape(2, True)] == [
        "Your first escape from this room", "Your best so far; it was 87", "Your best is 89",
        "Your first escape from this room"]
    Path(PERSONAL_BESTS).write_text("[1, 2")
    assert escape(0) == "Your first escape from this room", "a damaged file is begun anew"
