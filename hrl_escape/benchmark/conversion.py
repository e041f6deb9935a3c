"""Files of version 0.3 in the form of this version: agent labels become specs, and renamed fields follow.

Runs keep their weights, curves and settings. A run is loaded, watched, recorded and packed again; it is not resumed,
for a run is resumed by the version that began it. Recordings are converted by `data/convert.py`.
"""

from __future__ import annotations

import json
import re
import tempfile
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from hrl_escape.agents.old_specs import MANAGERS, NEW_NAMES, convert_label, refuse_old
from hrl_escape.agents.registry import split_name
from hrl_escape.agents.spec import AgentSpec
from hrl_escape.agents.training.archive import (
    DESCRIBED,
    RESULT,
    RUN_ARCHIVE,
    RUN_FILES,
    making_folder,
    pack_parts,
    read_parts,
)
from hrl_escape.agents.training.checkpoint import load_checkpoint, save_checkpoint
from hrl_escape.agents.training.env_description import compute_digest, hash_large_parts
from hrl_escape.agents.training.run_folder import BEST, LAST
from hrl_escape.agents.training.run_folder import FORMAT as RUN_FORMAT
from hrl_escape.benchmark.grid import GRID_FORMAT, Grid
from hrl_escape.benchmark.submission import RUN, SUBMISSION
from hrl_escape.errors import AgentSettingsError, FileReadError, UnsupportedError
from hrl_escape.files import open_plain, read_json, read_text, read_toml, write_json, write_text
from hrl_escape.sets.room_spec import renew_room

OLD_RUN_FORMAT = 2
"""Format of the runs of version 0.3."""
MOVED = {"hrl_escape.agents.algorithms.given.": "hrl_escape.agents.algorithms.task_hierarchies.",
         "hrl_escape.agents.larg2019.": "hrl_escape.agents.keras_rl_2019.",
         "hrl_escape.agents.label": "hrl_escape.agents.spec",
         "hrl_escape.comparison.places:RoomSchedule": "hrl_escape.sets.room_schedule:RoomSchedule",
         **{f"hrl_escape.ladder.{name}:": f"hrl_escape.sets.{name}:"
            for name in ("common_spaces", "goals", "instance_set", "sequence")},
         "hrl_escape.synthesis.": "hrl_escape.hierarchies.",
         "hrl_escape.text.told_env:ToldEnv": "hrl_escape.text.text_env:TextEnv"}
"""Modules of version 0.3 whose parts have moved."""
RENAMED = {"hrl_escape.hierarchies.hierarchy_env:HierarchyEnv": {"leaves": "low_level"},
           "hrl_escape.text.text_env:TextEnv": {"told": "reveal"}}
"""Arguments of environments and wrappers that have another name now, by class."""
NEW_FIELDS = {"flavour": "option_set"}
"""Fields that have another name now, wherever they are."""
VALUES = {"press-markov": "press-reactive"}
"""Names of option sets that are others now."""


def convert_file(path: Path, out: Path) -> str:
    """Write a file or folder of version 0.3 in the form of this version.

    Args:
        path: a run's folder or archive, a submission such as a pretrained agent, or a grid (.toml, .json).
        out: what to write; it must not be there.

    Returns:
        What was converted, in words.

    Raises:
        FileReadError: there is no such file, or it cannot be read.
        CheckpointError: a run is damaged.
        UnsupportedError: it holds nothing to convert; the message says why.
        FileWriteError: `out` is there already, or cannot be written.
    """
    if out.exists():
        raise UnsupportedError(f"{out} is there already: give another --out")
    if path.is_dir():
        return _convert_folder(path, out)
    if path.suffix.lower() in (".toml", ".json"):
        return _convert_grid_file(path, out)
    if path.suffix.lower() == ".zip":
        return _convert_archive(path, out)
    if not path.exists():
        raise FileReadError(f"{path}: no such file or folder")
    raise UnsupportedError(f"{path}: convert takes the folder or archive of a run, a submission, or a grid (.toml, "
                           ".json)")


# --- runs ------------------------------------------------------------------------------


def _convert_folder(path: Path, out: Path) -> str:
    if not (path / DESCRIBED).is_file():
        if (path / "grid.json").is_file():
            raise UnsupportedError(f"{path} is a comparison: its results count for version 0.3 alone. Convert "
                                   f"{path / 'grid.json'} and run it; training folders in it convert one by one")
        raise UnsupportedError(f"{path} holds no run: there is no {DESCRIBED}")
    with making_folder(out) as made:
        for name in RUN_FILES:
            if (path / name).is_file():
                with open_plain(path / name, "part of a run", largest=2**32) as source:
                    (made / name).write_bytes(source.read())
        return _convert_run(made, path)


def _convert_run(folder: Path, where: Path) -> str:
    """Convert the run in a folder that nobody else uses."""
    described = read_json(folder / DESCRIBED, "description of a run")
    if not isinstance(described, dict) or described.get("format") != OLD_RUN_FORMAT:
        found = described.get("format") if isinstance(described, dict) else None
        raise UnsupportedError(f"{where}: this run is of format {found!r}; version 0.3 wrote format {OLD_RUN_FORMAT}")
    new = convert_run_description(described)
    key = compute_digest(hash_large_parts(new))
    write_json(folder / DESCRIBED, new)
    for name in (LAST, BEST):
        if (folder / name).is_file():
            save_checkpoint(folder / name, {**load_checkpoint(folder / name), "key": key})
    if (folder / RESULT).is_file():
        result = read_json(folder / RESULT, "result of a run")
        write_json(folder / RESULT, {**result, "key": key, "agent_name": _convert_name(result["agent_name"])})
    return f"the run of {new['name']}, seed {new['seed']}"


def convert_run_description(described: Mapping[str, Any]) -> dict[str, Any]:
    """The description of a run of version 0.3 in the form of this version."""
    made = rename_fields(described)
    return {**made, "format": RUN_FORMAT, "name": _convert_name(described["name"])}


def _convert_name(name: str) -> str:
    """Name of an agent in a description, which says elsewhere what its choices are."""
    return NEW_NAMES.get(name, name)


def rename_fields(value: Any) -> Any:
    """JSON value with the new places of classes, and the new names of fields, arguments and option sets."""
    if isinstance(value, list):
        return [rename_fields(each) for each in value]
    if isinstance(value, str):
        for old, new in MOVED.items():
            if value.startswith(old):
                return new + value.removeprefix(old)
        return VALUES.get(value, value)
    if not isinstance(value, Mapping):
        return value
    made = {NEW_FIELDS.get(name, name): rename_fields(each) for name, each in value.items()}
    names = RENAMED.get(made.get("class", ""), {}) if isinstance(made.get("class", ""), str) else {}
    if names and isinstance(made.get("arguments"), dict):
        made["arguments"] = {names.get(name, name): each for name, each in made["arguments"].items()}
    return made


# --- archives --------------------------------------------------------------------------


def _convert_archive(path: Path, out: Path) -> str:
    """Convert the archive of a run, or a submission, in which the archive of a run may be."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        names = _list_members(path)
        if DESCRIBED in names:
            read_parts(path, RUN_ARCHIVE, [DESCRIBED], folder)
            said = _convert_run(folder, path)
            pack_parts(out, _list_parts(folder, names), RUN_ARCHIVE)
            return said
        if "submission.json" not in names:
            raise UnsupportedError(f"{path} is neither the archive of a run nor a submission")
        read_parts(path, SUBMISSION, ["submission.json"], folder)
        entry = read_json(folder / "submission.json", "submission")
        write_json(folder / "submission.json", convert_entry(entry))
        if RUN in names:
            packed = folder / "packed.zip"
            (folder / RUN).rename(folder / "old.zip")
            _convert_archive(folder / "old.zip", packed)
            packed.rename(folder / RUN)
        pack_parts(out, _list_parts(folder, names), SUBMISSION)
        return f"the submission {entry['card']['name']!r}"


def _list_members(path: Path) -> list[str]:
    import zipfile

    with open_plain(path, "archive", largest=2**32) as file:
        try:
            return [name for name in zipfile.ZipFile(file).namelist() if name != "manifest.json"]
        except zipfile.BadZipFile as error:
            raise FileReadError(f"{path}: this is no archive: {error}") from error


def _list_parts(folder: Path, names: Iterable[str]) -> dict[str, Path | bytes]:
    return {name: folder / name for name in names}


def convert_entry(entry: Mapping[str, Any]) -> dict[str, Any]:
    """Statement of a submission of version 0.3 in the form of this version."""
    card = entry["card"]
    options = card["view"]["options"] if card["view"]["choices"] == "options" else {}
    name = convert_text(card["name"]) if options == {} or not _is_label(card["name"]) else convert_label(
        card["name"], options.get("include_primitives"))
    return {**rename_fields(entry), "agent": _convert_name(entry["agent"]),
            "card": {**rename_fields(card), "name": name, "training": convert_text(card["training"])}}


# --- grids -----------------------------------------------------------------------------


def _convert_grid_file(path: Path, out: Path) -> str:
    is_toml = path.suffix.lower() == ".toml"
    content = read_toml(path, "grid") if is_toml else read_json(path, "grid")
    if not isinstance(content, dict) or "agents" not in content:
        raise UnsupportedError(f"{path}: this is no grid, for it has no agents")
    if "format" in content:
        raise UnsupportedError(f"{path}: this grid is of format {content['format']} already")
    made = {"format": GRID_FORMAT, **convert_grid(content)}
    Grid.from_dict({"agents": made["agents"]})  # refuses what no agent is
    if is_toml:
        comments = [line for line in read_text(path, "grid").splitlines() if line.startswith("#")]
        write_text(out, "".join(f"{line}\n" for line in comments) + write_toml(made))
    else:
        write_json(out, made)
    return f"the grid with {len(made['agents'])} agents"


def convert_grid(content: Mapping[str, Any]) -> dict[str, Any]:
    """The table of a grid of version 0.3 with the agents and the texts of rooms of this version."""
    rooms = {name: [renew_room(room) for room in content[name]]
             for name in ("rooms", "train_rooms", "test_rooms") if name in content}
    return {**content, **rooms, "agents": [convert_label(agent) if isinstance(agent, str) else _convert_agent(agent)
                                           for agent in content["agents"]]}


def _convert_agent(agent: Mapping[str, Any]) -> dict[str, Any]:
    """The table of an agent: an agent over options chose primitives too, where nothing else is said."""
    name, recipe = agent.get("name", "random"), agent.get("recipe", "corrected")
    options = dict(agent.get("options", {}))
    spec = AgentSpec.parse(convert_label(f"{name}@{recipe}", options.pop("include_primitives", True)))
    made: dict[str, Any] = {"name": spec.name}
    options = rename_fields(options)
    label = agent.get("label", "")
    if label and not (label.startswith(name) and label[len(name):][:1] in ("", "@", "+")):
        made["label"] = label
    if spec.recipe != AgentSpec().recipe:
        made["recipe"] = spec.recipe
    settings = dict(agent.get("settings", {}))
    if "model" in settings and spec.name == "text-agent":
        settings["model"] = MANAGERS.get(settings["model"], settings["model"])
    if "told" in settings and spec.name == "text-agent":
        settings["reveal"] = settings.pop("told")
    if settings:
        made["settings"] = settings
    if spec.options.include_primitives:
        options = {"include_primitives": True, **options}
    if options and spec.chooses_options:
        made["options"] = options
    if agent.get("leaves") is not None:
        made["low_level"] = agent["leaves"]
    return made


# --- text ------------------------------------------------------------------------------

_WORD = re.compile(r"(?<![\w+@/.-])[a-z0-9-]+(?:@[a-z0-9-]+)?(?:\+[a-z-]+)*(?![\w/.-])")


def _is_label(word: str) -> bool:
    """Return whether a word is a label of version 0.3 that has another text now."""
    try:
        refuse_old(word)
    except AgentSettingsError:
        return True
    return word.startswith("smdp-") and split_name(word)[1]


def convert_text(text: str) -> str:
    """Text, such as a command, in which each label of version 0.3 is the spec of this version."""
    return _WORD.sub(lambda match: convert_label(match[0]) if _is_label(match[0]) and match[0] != "planner"
                     else match[0], text)


def write_toml(value: Mapping[str, Any]) -> str:
    """TOML document of a table of JSON values; tables in it are written inline."""
    return "".join(f"{_write_key(name)} = {_write(each)}\n" for name, each in value.items() if each is not None)


def _write(value: Any) -> str:
    if isinstance(value, Mapping):
        inner = ", ".join(f"{_write_key(name)} = {_write(each)}" for name, each in value.items() if each is not None)
        return f"{{ {inner} }}" if inner else "{}"
    if isinstance(value, (list, tuple)):
        lines = "".join(f"    {_write(each)},\n" for each in value)
        is_short = not any(isinstance(each, (Mapping, str)) for each in value)
        return f"[{', '.join(map(_write, value))}]" if is_short else f"[\n{lines}]"
    return json.dumps(value)  # numbers, text and booleans are written alike


def _write_key(name: str) -> str:
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else json.dumps(name)


