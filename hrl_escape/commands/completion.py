"""Print a script that lets your shell complete commands, options and names.

Examples:
    hrl-escape completion bash > ~/.local/share/bash-completion/completions/hrl-escape
    source <(hrl-escape completion zsh)
"""

from __future__ import annotations

import dataclasses
import typing
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from hrl_escape.agents.registry import SMDP_PREFIX, list_all_agents
from hrl_escape.commands.list import Kind
from hrl_escape.commands.tree import find_commands
from hrl_escape.comparison.presets import GRIDS
from hrl_escape.comparison.references.registry import PLANNER, SEARCHERS
from hrl_escape.env.presets import PRESETS

_HEAD = {"bash": "", "zsh": "autoload -Uz bashcompinit && bashcompinit\n"}
_SCRIPT = """_hrl_escape() {{
  local here="${{COMP_WORDS[COMP_CWORD]}}" before="${{COMP_WORDS[COMP_CWORD-1]}}" path="${{COMP_WORDS[1]}}" words=""
  [[ $COMP_CWORD -eq 1 ]] && path=""
  case "$path" in {groups}) [[ $COMP_CWORD -gt 2 ]] && path="$path ${{COMP_WORDS[2]}}";; esac
  case "$path $before" in
  *" --preset") words="{presets}";;
{values}
  *) case "$path" in
{options}
  esac;; esac
  COMPREPLY=($(compgen -W "$words" -- "$here"))
}}
complete -o default -F _hrl_escape hrl-escape
"""


@dataclasses.dataclass(frozen=True)
class CompletionArgs:
    """Options of `hrl-escape completion`."""

    shell: Annotated[Literal["bash", "zsh"], tyro.conf.Positional] = "bash"
    """Shell that the script is for."""


def run(args: CompletionArgs) -> None:
    """Print the script."""
    agents = [prefix + name for name in list_all_agents() for prefix in ("", SMDP_PREFIX)]
    names = {"train": agents, "watch": [PLANNER, *SEARCHERS, *agents], "list": typing.get_args(Kind),
             "compare": [*GRIDS], "completion": _HEAD}
    values, options, groups = [], [], []
    for path, flags in _list_commands(Path(__file__).parent, __package__ or "", ""):
        words = [*flags, *names.get(path, ())]
        groups += [path] if path and "--help" not in words else []
        options.append(f'  "{path}") words="{" ".join(words)}";;')
        values += [f'  "{path} {flag}") words="{" ".join(choices)}";;' for flag, choices in flags.items() if choices]
    print(_HEAD[args.shell] + _SCRIPT.format(groups="|".join(groups), presets=" ".join(PRESETS),
                                             values="\n".join(values), options="\n".join(options)), end="")


def _list_commands(folder: Path, package: str, path: str) -> Iterator[tuple[str, dict[str, list[str]]]]:
    """Words of each command, with what may follow those that take one of a few names."""
    commands = find_commands(folder)
    yield path, {name: [] for name in commands}
    for name, file in commands.items():
        module, inner = f"{package}.{file.stem}", f"{path} {name}".strip()
        if file.is_dir():
            yield from _list_commands(file, module, inner)
        else:
            yield inner, {"--help": [], **_list_options(typing.get_type_hints(import_module(module).run)["args"])}


def _list_options(arguments: Any) -> dict[str, list[str]]:
    """Options of a command with the names that each takes, where those are few."""
    hints, found = typing.get_type_hints(arguments, include_extras=True), {}
    for field in dataclasses.fields(arguments):
        hint, marks = hints[field.name], getattr(hints[field.name], "__metadata__", ())
        if tyro.conf.Positional in marks:
            continue
        word = next((mark.name for mark in marks if getattr(mark, "name", None)), field.name)
        negation = "no-" if field.default is True else ""
        parts = [hint, *typing.get_args(hint)]
        found[f"--{negation}{word.replace('_', '-')}"] = [
            choice for part in parts if typing.get_origin(part) is Literal for choice in typing.get_args(part)]
    return found
