"""Descriptions of environments as JSON: a run's folder keeps one, to identify the environment and make it again.

A description names the innermost environment and the wrappers around it, each by its class and its arguments. An
environment can return its arguments by a `describe` method. Others are described by their Gymnasium spec, and wrappers
by Gymnasium's `RecordConstructorArgs`. Otherwise arguments are read from the attributes with their names, as in
`self.size = size`. An argument that is an object, such as an option, is described by its class, its name and a hash of
its content: its own `describe`, or its `state_dict` (an agent, a network), or its public values. Its `origin` is kept
in clear: of a learned option, the run that trained it.

A folder runs no code of its own, unless its description is trusted. The names in it, `module:name`, are looked up in
tables, without an import: this package's environments, wrappers and settings; the wrappers of Gymnasium that only
compute, and the environments registered with it; and the entry points of installed packages in the group
`hrl_escape.parts`. An entry point's name is free. Its value is the `module:name` in descriptions, such as
`doubled = "my_package.wrappers:Doubled"`.
"""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import importlib.util
import inspect
import json
import sys
from collections.abc import Callable, Iterator, Mapping
from importlib.metadata import entry_points
from pathlib import Path
from pkgutil import resolve_name
from types import ModuleType
from typing import Any, Protocol, runtime_checkable

import gymnasium
import numpy as np
from gymnasium import wrappers as standard
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils import RecordConstructorArgs
from gymnasium.vector import VectorWrapper
from gymnasium.wrappers import OrderEnforcing, PassiveEnvChecker, RecordEpisodeStatistics, RecordVideo, RenderCollection

from hrl_escape.agents.registry import join_name
from hrl_escape.agents.spec import AgentSpec, OptionsView
from hrl_escape.agents.training.checkpoint import compute_state_digest
from hrl_escape.errors import AgentSettingsError, CheckpointError, TrustError, UnsupportedError, describe_damage
from hrl_escape.files import read_text
from hrl_escape.settings import Settings

PASSIVE_WRAPPERS = (OrderEnforcing, PassiveEnvChecker, RecordEpisodeStatistics, RecordVideo, RenderCollection)
"""Wrappers that change no number; other such wrappers have the attribute `is_passive`."""
UNKNOWN = {"unknown": True}
"""Placeholder for an argument that no attribute keeps."""
PARTS_GROUP = "hrl_escape.parts"
"""Entry points of other packages: environments, wrappers, settings and functions that run folders can name."""

DESCRIBED_ID = "hrl_escape/Described-v1"
"""Id in the specs of environments that are kept by their description."""
MEMORY_WRAPPER = "hrl_escape.options.memory:DecisionMemory"

OWN = frozenset({
    "hrl_escape.env.mazes:PointMazeEnv",
    "hrl_escape.env.config:DynamicsConfig",
    "hrl_escape.env.config:ExitConfig",
    "hrl_escape.env.config:ObstaclesConfig",
    "hrl_escape.env.config:RobotConfig",
    "hrl_escape.env.config:RoomConfig",
    "hrl_escape.env.config:ShapeConfig",
    "hrl_escape.env.config:StartConfig",
    "hrl_escape.env.continuous:EscapeRoomContinuousEnv",
    "hrl_escape.env.escape_room:EscapeRoomEnv",
    "hrl_escape.env.instance:RoomInstance",
    "hrl_escape.env.rewards:RewardConfig",
    "hrl_escape.options.domain:OptionDomain",
    "hrl_escape.options.domain:RoomDomain",
    "hrl_escape.options.masked_observation:MaskedObservation",
    MEMORY_WRAPPER,
    "hrl_escape.options.options_env:OptionsEnv",
    "hrl_escape.sets.common_spaces:CommonSpacesEnv",
    "hrl_escape.sets.goals:GoalsEnv",
    "hrl_escape.sets.instance_set:InstanceSetEnv",
    "hrl_escape.sets.room_schedule:RoomSchedule",
    "hrl_escape.sets.sequence:SequenceEnv",
    "hrl_escape.hierarchies.hierarchy_env:HierarchyEnv",
    "hrl_escape.text.text_env:TextEnv",
})
"""Parts of this package, imported on first use."""

_COMPUTING = (
    standard.AddRenderObservation, standard.AddWhiteNoise, standard.AtariPreprocessing, standard.Autoreset,
    standard.ClipAction, standard.ClipReward, standard.DelayObservation, standard.DiscretizeAction,
    standard.DiscretizeObservation, standard.DtypeObservation, standard.FilterObservation, standard.FlattenObservation,
    standard.FrameStackObservation, standard.GrayscaleObservation, standard.MaxAndSkipObservation,
    standard.NormalizeObservation, standard.NormalizeReward, standard.ObstructView, standard.RenderCollection,
    standard.RepeatAction, standard.RescaleAction, standard.RescaleObservation, standard.ReshapeObservation,
    standard.ResizeObservation, standard.StickyAction, standard.TimeAwareObservation, standard.TimeLimit,
    standard.TransformAction, standard.TransformObservation, standard.TransformReward,
)
"""Wrappers of Gymnasium that neither write files nor open windows."""


@runtime_checkable
class DescribedEnv(Protocol):
    """Environment, or an argument of one, that returns the arguments to make an equal one."""

    def describe(self) -> Mapping[str, Any]:
        """Return the arguments that determine its numbers, as JSON values.

        A large argument can be `{"id": hash, "content": value}`: runs are then compared by the hash alone, and the
        environment is made again from the value.
        """
        ...


def describe_env(env: gymnasium.Env) -> dict[str, Any]:
    """Return the description of an environment, a JSON value."""
    wrappers = []
    while isinstance(env, gymnasium.Wrapper):
        if not isinstance(env, PASSIVE_WRAPPERS) and not getattr(env, "is_passive", False):
            saved = env._saved_kwargs if isinstance(env, RecordConstructorArgs) else _read_arguments(env)
            wrappers.append({"class": name_part(type(env)), "arguments": _make_plain(saved)})
        env = env.env
    if isinstance(env, DescribedEnv):
        arguments = env.describe()
    elif env.spec is not None:
        arguments = {name: value for name, value in env.spec.kwargs.items() if name != "render_mode"}
    else:
        arguments = _read_arguments(env)
    return {"class": name_part(type(env)), "arguments": _make_plain(arguments), "wrappers": wrappers[::-1]}


def check_spec(spec: AgentSpec, env: gymnasium.Env) -> None:
    """Require that an environment's options, memory and hierarchy agree with an agent's spec.

    Args:
        spec: options that it leaves at their defaults are not checked, except primitives among the choices.
        env: ordinary environment for training; one of another package can have options of its own.

    Raises:
        AgentSettingsError: they disagree; the message gives both solutions.
    """
    found: dict[str, Any] = {}
    for part in describe_env(env)["wrappers"]:
        found |= part["arguments"] | ({"memory": True} if part["class"] == MEMORY_WRAPPER else {})
    wanted = {name: value for name, value in spec.options.to_dict().items() if value != getattr(OptionsView, name)}
    wanted.pop("include_primitives", None)
    if spec.low_level is not None:
        wanted["low_level"] = spec.low_level
    disagrees = any(found.get(name) != value for name, value in wanted.items())
    if env.has_wrapper_attr("primitive_count"):
        has_primitives = env.get_wrapper_attr("primitive_count") > 0
        if not spec.chooses_options:
            raise AgentSettingsError("agent", str(spec), f"{spec.name} acts with primitives, and this environment has "
                                     f"options: take {_over_options(spec, has_primitives)}, or the environment without "
                                     "OptionsEnv")
        if has_primitives != spec.options.include_primitives:
            has = "also chooses primitives" if has_primitives else "has options only"
            raise AgentSettingsError("agent", str(spec), f"this environment {has}: take "
                                     f"{_over_options(spec, has_primitives)}, or the environment "
                                     f"{_write_needed(spec, wanted)}")
    if disagrees:
        raise AgentSettingsError("agent", str(spec), f"it needs the environment {_write_needed(spec, wanted)}: make "
                                 f"that, or take {spec.name} without these parts")


def _over_options(spec: AgentSpec, has_primitives: bool) -> str:
    """Return the spec of the same agent over options, with or without primitives."""
    name = join_name(spec.algorithm, True)
    options = dataclasses.replace(spec.options, include_primitives=has_primitives)
    return str(dataclasses.replace(spec, name=name, label="", options=options))


def _write_needed(spec: AgentSpec, wanted: Mapping[str, Any]) -> str:
    """Return code that makes the environment of a spec."""
    if spec.low_level is None and not spec.options.include_primitives:
        wanted = {"include_primitives": False, **wanted}
    arguments = "".join(f", {name}={value!r}" for name, value in wanted.items() if name != "memory")
    made = f"{'OptionsEnv' if spec.low_level is None else 'HierarchyEnv'}(env{arguments})"
    return f"DecisionMemory({made})" if "memory" in wanted else made


def describe_many(env: Any) -> dict[str, Any]:
    """Return the description of a vector environment, or of `ManyEnvs`, a JSON value for comparison only."""
    wrappers = []
    while isinstance(env, VectorWrapper):
        wrappers.append(name_part(type(env)))
        env = env.env
    spec = getattr(env, "spec", None)
    arguments = env.describe() if isinstance(env, DescribedEnv) else None if spec is None else spec.kwargs
    return {"class": name_part(type(env)), "arguments": _make_plain(arguments), "wrappers": wrappers[::-1]}


def make_described_env(description: Mapping[str, Any], wrap: Callable[[gymnasium.Env], gymnasium.Env] = lambda env: env,
                       *, trust: bool = False) -> gymnasium.Env:
    """Make an environment from its description.

    Args:
        description: from `describe_env`.
        wrap: function that is applied to the innermost environment, below its wrappers.
        trust: also import and call unknown parts; the description then runs any code that it names.

    Raises:
        TrustError: it names other code, and is not trusted; no module was imported.
        CheckpointError: the description is damaged or incomplete.
    """
    try:
        if not trust and (foreign := list_foreign(description)):
            raise TrustError(foreign)
        return _make_env(description, trust, wrap)
    except TrustError:
        raise
    except Exception as error:  # a damaged description makes constructors raise almost anything
        raise CheckpointError(f"this environment cannot be made from its description: {describe_damage(error)}. Make "
                              "it and give env=") from error


def make_spec(env: gymnasium.Env) -> EnvSpec:
    """Return a spec from which `gymnasium.make` makes an equal environment, in any process, also after JSON.

    It is the environment's own spec where that can be written as JSON, and otherwise one that holds its description.

    Raises:
        UnsupportedError: arguments of the environment cannot be described, such as options that are not a function of a
            module.
    """
    if env.spec is not None and _is_json(env.spec):
        return env.spec
    description = describe_env(env)
    if lost := sorted(set(_list_lost(description))):
        raise UnsupportedError(f"{env} cannot be made again from a file: {', '.join(lost)}. Give OptionsEnv a function "
                               "of a module that makes the options, as in OptionsEnv(env, my_options.make_options)")
    return _wrap_description(description)


def find_spec(env: gymnasium.Env, own: EnvSpec | None) -> EnvSpec | None:
    """Return an environment's own spec, or one that holds its description where only that can be written as JSON."""
    if own is None or _is_json(own):
        return own
    description = describe_env(env)
    return own if any(_list_lost(description)) else _wrap_description(description)


def _wrap_description(description: Mapping[str, Any]) -> EnvSpec:
    return EnvSpec(DESCRIBED_ID, f"{__name__}:{make_from_spec.__name__}", disable_env_checker=True,
                   kwargs={"description": description})


def make_from_spec(description: Mapping[str, Any], render_mode: str | None = None) -> gymnasium.Env:
    """Make the environment of a spec of `make_spec`; imports the code that it names, as every spec does.

    Args:
        description: from `describe_env`.
        render_mode: of the innermost environment.
    """
    if render_mode is not None:
        description = {**description, "arguments": {**description["arguments"], "render_mode": render_mode}}
    return make_described_env(description, trust=True)


def _is_json(spec: EnvSpec) -> bool:
    """Return whether a spec keeps all arguments as JSON."""
    if any(wrapper.kwargs is None for wrapper in spec.additional_wrappers):
        return False
    try:
        return bool(spec.to_json())
    except (TypeError, ValueError):
        return False


def _list_lost(value: Any) -> Iterator[str]:
    """Yield what a description names without keeping it."""
    if isinstance(value, list):
        for part in value:
            yield from _list_lost(part)
    elif isinstance(value, Mapping) and {"object", "digest"} <= value.keys():
        yield f"{value['object']} {value.get('name', '')}".strip()
    elif isinstance(value, Mapping):
        for name, part in value.items():
            yield from [f"argument {name}"] if part == UNKNOWN else _list_lost(part)


def list_foreign(description: Any) -> list[Any]:
    """Names in a description, each `module:name`, of code that runs only if the caller trusts it."""
    foreign: list[Any] = []
    for name in _list_names(description):
        if name not in foreign and find_part(name) is None:
            foreign.append(name)
    return foreign


def hash_large_parts(value: Any, kinds: type | tuple[type, ...] = object) -> Any:
    """Copy a JSON value, and replace large arguments whose content is of some kind by their hash."""
    if isinstance(value, Mapping):
        if value.keys() == {"id", "content"} and isinstance(value["content"], kinds):
            return value["id"]
        return {name: hash_large_parts(part, kinds) for name, part in value.items()}
    return [hash_large_parts(part, kinds) for part in value] if isinstance(value, list) else value


def compute_digest(value: Any) -> str:
    """Return a short hash of a JSON value: 8 hexadecimal digits of SHA-256 over its canonical form."""
    text = json.dumps(value, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()[:8]


def _list_names(value: Any) -> Iterator[Any]:
    """Names of the code that makes a described value, see `_revive`."""
    if isinstance(value, list):
        for part in value:
            yield from _list_names(part)
    elif isinstance(value, Mapping) and value.keys() != {"id", "content"}:
        if value.keys() == {"settings", "fields"} or value.keys() == {"function"}:
            yield value.get("settings", value.get("function"))
        else:
            if "class" in value and "arguments" in value:
                yield value["class"]
            for part in value.values():
                yield from _list_names(part)


def load_part(name: Any, trust: bool) -> Any:
    """Return the class or function of a name, `module:name`.

    Raises:
        TrustError: it is in no table of known parts, and is not trusted; no module was imported.
    """
    load = find_part(name)
    if load is None and not trust:
        raise TrustError([name])
    if load is not None:
        return load()
    place, _, part = str(name).rpartition(":")
    return getattr(load_file(place), part) if place.endswith(".py") else resolve_name(name)


def _make_env(description: Mapping[str, Any], trust: bool,
              wrap: Callable[[gymnasium.Env], gymnasium.Env] = lambda env: env) -> gymnasium.Env:
    env = wrap(_make_part(description, gymnasium.Env, trust))
    for wrapper in description["wrappers"]:
        env = _make_part(wrapper, gymnasium.Wrapper, trust, env)
    return env


def _make_part(description: Mapping[str, Any], kind: type, trust: bool, *inner: gymnasium.Env) -> Any:
    part = load_part(description["class"], trust)
    if not (isinstance(part, type) and issubclass(part, kind)):
        raise TypeError(f"{description['class']} is no {kind.__name__}")
    arguments = description["arguments"]
    unknown = [name for name, value in arguments.items() if value == UNKNOWN]
    if unknown:
        raise TypeError(f"{', '.join(unknown)} of {description['class']} is not kept with a run")
    return part(*inner, **{name: _revive(value, trust) for name, value in arguments.items()})


def _read_arguments(part: Any) -> dict[str, Any]:
    """Return the arguments of an environment or a wrapper, from attributes with their names, with or without `_`."""
    arguments: dict[str, Any] = {}
    for parameter in inspect.signature(type(part)).parameters.values():
        held = [vars(part)[name] for name in (parameter.name, f"_{parameter.name}") if name in vars(part)]
        if parameter.name != "render_mode" and not (held and isinstance(held[0], gymnasium.Env)):
            arguments[parameter.name] = held[0] if held else UNKNOWN
    return arguments


def _make_plain(value: Any) -> Any:
    """Convert an argument to a JSON value; functions are named, other objects named and hashed."""
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    if isinstance(value, (np.generic, np.ndarray)):
        return value.tolist()
    if isinstance(value, Mapping):
        return {str(name): _make_plain(part) for name, part in value.items()}
    if isinstance(value, (list, tuple)):
        return [_make_plain(part) for part in value]
    if isinstance(value, (set, frozenset)):  # their order differs from process to process
        return sorted((_make_plain(part) for part in value), key=lambda part: json.dumps(part, sort_keys=True))
    if isinstance(value, Settings):
        return {"settings": name_part(type(value)), "fields": value.to_dict()}
    if inspect.ismethod(value) and not isinstance(value.__self__, type):
        return _describe_object(value, {"name": name_part(value), "of": _make_plain(value.__self__)})
    if inspect.isroutine(value) or isinstance(value, type):
        name = name_part(value)
        return {"function": name} if "<" not in name else _describe_object(value, _list_code(value))
    if isinstance(value, functools.partial):
        return _describe_object(value, {"call": _make_plain([value.func, value.args, value.keywords])})
    if hasattr(value, "state_dict"):
        return _describe_object(value, {"learned": compute_state_digest(dict(value.state_dict()))})
    if isinstance(value, DescribedEnv):
        content = _make_plain(value.describe())
        described = _describe_object(value, {"name": getattr(value, "name", ""), "content": content})
        return described | ({"origin": content["origin"]} if "origin" in content else {})
    if not hasattr(value, "__dict__"):
        return _describe_object(value, {"value": repr(value)})
    return _describe_object(
        value, {name: _make_plain(part) for name, part in vars(value).items() if _is_value(name, part)})


def compute_code_digest(part: Any) -> str:
    """Return a hash of the code of a function or a class, with its constants and bound values.

    Functions that it calls and bases from this package are not included.
    """
    if not isinstance(part, type):
        return compute_digest(_list_code(part) if inspect.isfunction(part) else _make_plain(part))
    bases = [base for base in part.__mro__
             if base is part or base.__module__.partition(".")[0] not in ("hrl_escape", "abc", "builtins")]
    members = [[name, _list_code(value) if inspect.isfunction(value) else _make_plain(value)]
               for base in bases for name, value in _list_members(base)]
    return compute_digest(members)


def _list_members(kind: type) -> list[tuple[str, Any]]:
    """Return functions and values that a class defines, by name; nested classes are left out."""
    found = [(name, getattr(value, "__func__", getattr(value, "fget", value)))
             for name, value in sorted(vars(kind).items())]
    return [(name, value) for name, value in found if inspect.isfunction(value)
            or not (name.startswith("__") or name == "_abc_impl" or isinstance(value, type))]


def _describe_object(value: Any, fields: Mapping[str, Any]) -> dict[str, Any]:
    return {"object": name_part(type(value)), "name": str(fields.get("name", "")), "digest": compute_digest(fields)}


def _list_code(function: Any) -> dict[str, Any]:
    """Return code and bound values of a function without a name in its module, such as a lambda."""
    code = getattr(function, "__code__", None)
    if code is None:
        return {"name": name_part(function)}
    bound = [cell.cell_contents for cell in function.__closure__ or () if cell.cell_contents is not function]
    defaults = [list(function.__defaults__ or ()), function.__kwdefaults__ or {}]
    return {"name": name_part(function), "code": _list_instructions(code), "values": _make_plain([defaults, bound])}


def _list_instructions(code: Any) -> list[Any]:
    """Return instructions of code with their names and constants, including functions made in it."""
    constants = [_list_instructions(each) if inspect.iscode(each) else _make_plain(each) for each in code.co_consts]
    return [code.co_code.hex(), list(code.co_names), constants]


def _is_value(name: str, value: Any) -> bool:
    if isinstance(value, (list, tuple)):
        return all(_is_value(name, part) for part in value)
    kinds = (bool, int, float, str, np.generic, np.ndarray, Settings)
    return not name.startswith("_") and (value is None or isinstance(value, kinds))


def _revive(value: Any, trust: bool) -> Any:
    if isinstance(value, list):
        return [_revive(part, trust) for part in value]
    if not isinstance(value, Mapping):
        return value
    if value.keys() == {"id", "content"}:
        return value["content"]
    if value.keys() == {"class", "arguments", "wrappers"}:
        return _make_env(value, trust)
    if value.keys() == {"settings", "fields"}:
        settings = load_part(value["settings"], trust)
        if not (isinstance(settings, type) and issubclass(settings, Settings)):
            raise TypeError(f"{value['settings']} is no Settings")
        return settings.from_dict(value["fields"])
    if value.keys() == {"function"}:
        return load_part(value["function"], trust)
    if value.keys() - {"origin"} == {"object", "name", "digest"}:
        raise TypeError(f"an object of {value['object']} is not kept with a run")
    return {name: _revive(part, trust) for name, part in value.items()}


# --- code that a description can name ---------------------------------------------------


def name_part(part: Any) -> str:
    """Return the name of a class or function in descriptions, `module:name`."""
    return f"{part.__module__}:{part.__qualname__}"


def load_file(path: str) -> ModuleType:
    """Import a Python file, once a process, as the module with the name of its path.

    Descriptions then name a function of the file as `path:function`. The path is relative to the working folder.

    Raises:
        FileReadError: there is no such file.
        Exception: of the file's code.
    """
    read_text(path, "Python file")
    place = str(Path(path).absolute())
    module = sys.modules.get(path)
    if module is None or module.__file__ != place:
        spec = importlib.util.spec_from_file_location(path, place)
        assert spec is not None and spec.loader is not None
        module = sys.modules[path] = importlib.util.module_from_spec(spec)
        try:
            spec.loader.exec_module(module)
        except BaseException:
            del sys.modules[path]
            raise
    return module


def hash_files(description: Mapping[str, Any]) -> dict[str, str]:
    """Return a hash of each Python file that a description names, by its path."""
    modules = {str(name).rpartition(":")[0] for name in _list_names(description)}
    hashes = {}
    for path in sorted(modules):
        if path.endswith(".py"):
            hashes[path] = hashlib.sha256(read_text(path, "Python file").encode()).hexdigest()[:8]
    return hashes


def find_part(name: Any) -> Callable[[], Any] | None:
    """Return the loader of a name's part, or None if the name is not known. It imports no module."""
    return next((load for known, load in _list_parts() if known == name), None)


def _list_parts() -> Iterator[tuple[str, Callable[[], Any]]]:
    yield from ((name, lambda name=name: resolve_name(name)) for name in OWN)
    yield from ((name_part(wrapper), lambda wrapper=wrapper: wrapper) for wrapper in _COMPUTING)
    for spec in gymnasium.registry.values():
        made_by = spec.entry_point
        if isinstance(made_by, str):
            yield made_by, lambda made_by=made_by: resolve_name(made_by)
        elif isinstance(made_by, type):
            yield name_part(made_by), lambda made_by=made_by: made_by
    yield from ((point.value, point.load) for point in entry_points(group=PARTS_GROUP))
