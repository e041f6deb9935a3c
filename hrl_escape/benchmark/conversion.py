"""Conversion of runs, trained agents and grids of version 0.3: agent labels become specs, and fields are renamed.

Runs keep their weights, curves and settings. A converted run can be loaded, watched, recorded and packed, but not
resumed. `data/convert.py` converts recordings.
"""

from __future__ import annotations

import csv
import io
import json
import re
import tempfile
import zipfile
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from hrl_escape.agents.old_fields import rename_fields
from hrl_escape.agents.old_specs import MANAGERS, NEW_NAMES, convert_label, refuse_old
from hrl_escape.agents.registry import split_name
from hrl_escape.agents.spec import AgentSpec
from hrl_escape.agents.training.archive import (
    DESCRIBED,
    RESULT,
    RUN_ARCHIVE,
    RUN_FILES,
    ArchiveKind,
    making_folder,
    pack_parts,
    read_parts,
)
from hrl_escape.agents.training.checkpoint import load_checkpoint, save_checkpoint
from hrl_escape.agents.training.env_description import compute_digest, hash_large_parts
from hrl_escape.agents.training.run_folder import BEST, LAST
from hrl_escape.agents.training.run_folder import FORMAT as RUN_FORMAT
from hrl_escape.benchmark.agent_archive import RUN, AgentCard, RoomResult, check_results, write_archive
from hrl_escape.benchmark.grid import GRID_FORMAT, Grid
from hrl_escape.errors import AgentSettingsError, EscapeError, FileReadError, UnsupportedError, describe_damage
from hrl_escape.files import list_members, open_plain, read_json, read_text, read_toml, write_json, write_text
from hrl_escape.sets.room_spec import renew_room

_SUBMISSION = ArchiveKind("a submission of version 0.3", re.compile(r"submission\.json|cells\.csv|run\.zip"),
                          "Only submissions with a training run are converted")
OLD_RUN_FORMAT = 2
"""Format of the runs of version 0.3."""


def convert_file(path: Path, out: Path) -> str:
    """Convert a file or folder of version 0.3 to this version.

    Args:
        path: a run's folder or archive, the archive of a trained agent, or a grid (.toml, .json).
        out: what to write.

    Returns:
        Description of the converted file.

    Raises:
        FileReadError: no such file, or it cannot be read.
        CheckpointError: a run is damaged.
        UnsupportedError: the file is of another kind or version.
        FileWriteError: `out` cannot be written.
    """
    converters = {".toml": _convert_grid_file, ".json": _convert_grid_file, ".zip": _convert_archive}
    convert = _convert_folder if path.is_dir() else converters.get(path.suffix.lower())
    if convert is not None:
        try:
            return convert(path, out)
        except (AttributeError, LookupError, TypeError, ValueError) as error:
            if isinstance(error, EscapeError):
                raise
            raise FileReadError(f"{path}: this file of version 0.3 is damaged ({describe_damage(error)})") from error
    if not path.exists():
        raise FileReadError(f"{path}: no such file or folder")
    raise UnsupportedError(f"{path}: convert takes the folder or archive of a run, a trained agent, or a grid (.toml, "
                           ".json)")


# --- runs ------------------------------------------------------------------------------


def _convert_folder(path: Path, out: Path) -> str:
    if not (path / DESCRIBED).is_file():
        if (path / "grid.json").is_file():
            raise UnsupportedError(f"{path} is a comparison: its results belong to version 0.3. Convert "
                                   f"{path / 'grid.json'} and run it; training folders in it convert one by one")
        raise UnsupportedError(f"{path} holds no run: there is no {DESCRIBED}")
    with making_folder(out) as made:
        for name in RUN_FILES:
            if (path / name).is_file():
                with open_plain(path / name, "part of a run", largest=2**32) as source:
                    (made / name).write_bytes(source.read())
        return _convert_run(made, path)


def _convert_run(folder: Path, where: Path) -> str:
    """Convert the run in a temporary folder, in place."""
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
    """Convert the description of a run of version 0.3."""
    made = rename_fields(described)
    return {**made, "format": RUN_FORMAT, "name": _convert_name(described["name"])}


def _convert_name(name: str) -> str:
    """Convert the name of an agent in a description, whose options are in other fields."""
    return NEW_NAMES.get(name, name)


# --- archives --------------------------------------------------------------------------


def _convert_archive(path: Path, out: Path) -> str:
    """Convert the archive of a run, or a submission with the archive of a run in it."""
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
        if RUN not in names:
            raise UnsupportedError(f"{path} is a submission without a training run, which the leaderboard in the "
                                   "source code keeps as a result file; see benchmarks/leaderboard")
        read_parts(path, _SUBMISSION, ["submission.json", "cells.csv"], folder)
        card = AgentCard.from_dict(convert_card(read_json(folder / "submission.json", "submission")))
        results = convert_cells(read_text(folder / "cells.csv", "results of a submission"))
        check_results(card, results)
        _convert_archive(folder / RUN, folder / "converted.zip")
        write_archive(out, card, results, folder / "converted.zip")
        return f"the trained agent {card.name!r}"


def _list_members(path: Path) -> list[str]:
    try:
        return [name for name in list_members(path, "archive", 2**32) if name != "manifest.json"]
    except zipfile.BadZipFile as error:
        raise FileReadError(f"{path}: this is no archive: {error}") from error


def _list_parts(folder: Path, names: Iterable[str]) -> dict[str, Path | bytes]:
    return {name: folder / name for name in names}


def convert_card(entry: Mapping[str, Any]) -> dict[str, Any]:
    """Convert the card of a submission of version 0.3."""
    card = rename_fields(entry["card"])
    options = card["view"]["options"] if card["view"]["choices"] == "options" else {}
    name = convert_text(card["name"]) if options == {} or not _is_label(card["name"]) else convert_label(
        card["name"], options.get("include_primitives"))
    same = ("authors", "link", "primitives", "core_hours", "view")
    return {**{field: card[field] for field in same}, "name": name, "agent": _convert_name(entry["agent"]),
            "information": card["told"], "training": convert_text(card["training"]),
            **{field: entry[field] for field in ("benchmark", "rung", "root", "rooms", "package")}}


def convert_cells(text: str) -> list[RoomResult]:
    """Convert the table of results of a submission of version 0.3."""
    return [RoomResult(int(row["room"]), row["escaped"] == "1", int(row["primitives"]), int(row["decisions"]),
                       float(row["total"]), float(row["fewest"]))
            for row in csv.DictReader(io.StringIO(text)) if row["set"] == "test"]


# --- grids -----------------------------------------------------------------------------


def _convert_grid_file(path: Path, out: Path) -> str:
    is_toml = path.suffix.lower() == ".toml"
    content = read_toml(path, "grid") if is_toml else read_json(path, "grid")
    if not isinstance(content, dict) or "agents" not in content:
        raise UnsupportedError(f"{path}: not a grid: it has no `agents`")
    if "format" in content:
        raise UnsupportedError(f"{path}: this grid is of format {content['format']} already")
    if content.get("until_solved") is not None:
        raise UnsupportedError(f"{path}: grids have no until_solved any more; give `train` a probe, such as "
                               "studies/scaling/solved_probe.py of the source code")
    made = {"format": GRID_FORMAT, **convert_grid(content)}
    Grid.from_dict({"agents": made["agents"]})  # raises for unknown agents
    if is_toml:
        comments = [line for line in read_text(path, "grid").splitlines() if line.startswith("#")]
        write_text(out, "".join(f"{line}\n" for line in comments) + write_toml(made))
    else:
        write_json(out, made)
    return f"the grid with {len(made['agents'])} agents"


def convert_grid(content: Mapping[str, Any]) -> dict[str, Any]:
    """Convert the table of a grid of version 0.3."""
    rooms = {name: [renew_room(room) for room in content[name]]
             for name in ("rooms", "train_rooms", "test_rooms") if name in content}
    kept = {name: value for name, value in content.items() if name != "until_solved" or value is not None}
    return {**kept, **rooms, "agents": [convert_label(agent) if isinstance(agent, str) else _convert_agent(agent)
                                           for agent in content["agents"]]}


def _convert_agent(agent: Mapping[str, Any]) -> dict[str, Any]:
    """Convert the table of an agent; agents over options also chose primitives by default."""
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
    settings = rename_fields(agent.get("settings", {}))
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
    """Return whether a word is a label of version 0.3 with a new spec."""
    try:
        refuse_old(word)
    except AgentSettingsError:
        return True
    return word.startswith("smdp-") and split_name(word)[1]


def convert_text(text: str) -> str:
    """Replace each label of version 0.3 in a text, such as a command, by its spec."""
    return _WORD.sub(lambda match: convert_label(match[0]) if _is_label(match[0]) and match[0] != "planner"
                     else match[0], text)


def write_toml(value: Mapping[str, Any]) -> str:
    """Format a table of JSON values as TOML, with inline tables."""
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


