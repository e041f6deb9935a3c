"""Exceptions of hrl_escape, one class per cause.

Each message names the mistake, its place, and the valid values. All classes derive from `EscapeError`, and one `except`
catches every error that this package raises on purpose.
"""

from __future__ import annotations

import difflib
import enum
import functools
import math
import reprlib
from collections.abc import Iterable
from typing import Any

from typing_extensions import Self


class EscapeError(Exception):
    """Base class of errors that hrl_escape raises on purpose. Errors of workers reach the parent process intact."""

    def __new__(cls, *given: Any, **named: Any) -> Self:
        """Keep the arguments, which copies in other processes are made from."""
        made: Any = super().__new__(cls, *given)
        made._given = given, named
        return made

    def __reduce__(self) -> tuple[Any, tuple]:
        given, named = vars(self)["_given"]
        return functools.partial(type(self), **named), given


_SHORT = reprlib.Repr()
_SHORT.maxstring = _SHORT.maxother = 200
_SHORT.maxlist = _SHORT.maxtuple = _SHORT.maxdict = 12
_SHORT.maxlevel = 3
_LONGEST_SHOWN = 400


def show_value(value: object) -> str:
    """Return the value as Python writes it, shortened if it is long."""
    try:
        shown = _SHORT.repr(value)
        return shown if len(shown) <= _LONGEST_SHOWN else f"{shown[:_LONGEST_SHOWN]}..."
    except ValueError:  # an integer with more digits than Python converts
        return "a number of thousands of digits"


def name_install(extra: str) -> str:
    """Return the command that installs an extra from a checkout, because the package is not published."""
    return f"pip install -c constraints.txt '.[{extra}]' in a checkout of hrl-escape"


# --- rooms -----------------------------------------------------------------------------


class ConfigError(EscapeError, ValueError):
    """A value in a room configuration is not valid.

    Attributes:
        field: dotted path of the field, such as `robot.body_radius`.
        value: the invalid value.
        allowed: valid values, in words.
    """

    def __init__(self, field: str, value: object, allowed: str) -> None:
        self.field, self.value, self.allowed = field, value, allowed
        super().__init__(f"{field} = {show_value(value)} is not possible: {allowed}")


class GenerationError(EscapeError, RuntimeError):
    """Sampling found no solvable room for a room configuration within its number of tries.

    Attributes:
        constraint: the constraint that failed last.
        tries: number of sampled rooms.
    """

    def __init__(self, constraint: str, tries: int, advice: str) -> None:
        self.constraint, self.tries, self.advice = constraint, tries, advice
        super().__init__(f"no solvable room in {tries} tries; the last failed at: {constraint}. {advice}")


class InstanceFileError(EscapeError, ValueError):
    """A file is not a room instance that this version can read."""


class RobotError(EscapeError, ValueError):
    """A robot's URDF is missing, unreadable, or incomplete."""


class UnknownNameError(EscapeError, KeyError):
    """A name is unknown. The message gives the closest known name, all known names, and a note if there is one."""

    def __init__(self, what: str, name: object, known: Iterable[str], note: str = "", closest: str | None = None
                 ) -> None:
        self.what, self.name, self.known = what, name, tuple(sorted(known))
        shown = show_value(name)
        longer = sorted((other for other in self.known if len(str(name)) > 2 and other.startswith(str(name))), key=len)
        close = longer or (difflib.get_close_matches(str(name), self.known, n=1) if len(shown) < 100 else ())
        closest = closest or (close[0] if close else None)
        hint = "." if closest is None else f"; did you mean {closest!r}?"
        self.message = f"unknown {what} {shown}{hint} Known: {', '.join(self.known) or 'none'}{note}"
        super().__init__(self.message)

    def __str__(self) -> str:
        return self.message


class ActionError(EscapeError, ValueError):
    """An action is outside the action space."""

    def __init__(self, action: object, count: int) -> None:
        self.action, self.count = action, count
        super().__init__(f"action {action!r} is not one of 0 to {count - 1}")


class ResetNeededError(EscapeError, RuntimeError):
    """`step` was called before the first `reset`, or after the end of an episode."""


class StateError(EscapeError, ValueError):
    """A state is not possible in this room."""


class ClosedError(EscapeError, RuntimeError):
    """The room is closed and cannot be used any more."""


class UnsupportedError(EscapeError, ValueError):
    """Two valid settings do not work together. The message names an alternative."""


class MissingExtraError(EscapeError, ImportError):
    """An optional package is not installed. The message names the extra that installs it."""

    def __init__(self, package: str, extra: str, purpose: str) -> None:
        self.package, self.extra, self.purpose = package, extra, purpose
        super().__init__(f"{purpose} needs {package}: {name_install(extra)}")


class MissingPackageError(EscapeError, ImportError):
    """A package of the default installation is missing or fails to load. Stepping rooms does not require it."""

    def __init__(self, package: str, purpose: str, reason: ImportError) -> None:
        self.package, self.purpose = package, purpose
        super().__init__(f"{purpose} needs the package {package}, which cannot be imported ({reason}): pip install "
                         f"-c constraints.txt {package} in a checkout of hrl-escape. Rooms step without it")


class FileWriteError(EscapeError, OSError):
    """A file could not be written (full disk, unwritable folder). The old file, if any, is unchanged."""


class FileReadError(EscapeError, OSError):
    """A file is missing, truncated or of the wrong kind."""


class OldFormatError(FileReadError):
    """A file was written by version 0.3. The message names the command that converts it."""

    def __init__(self, path: object, what: str) -> None:
        self.message = (f"{path}: this {what} is of version 0.3. `hrl-escape convert {path}` writes it in the form of "
                        "this version")
        super().__init__(self.message)

    def __str__(self) -> str:
        return self.message  # the default of OSError would show a number and a text


class PluginError(EscapeError, ImportError):
    """An entry point of an installed package fails to load."""


class ContractError(EscapeError, AssertionError):
    """A check found that an implementation violates its interface.

    Attributes:
        what: the implementation that was checked.
        claim: the property that must hold.
        seen: the observed behaviour.
    """

    def __init__(self, what: str, claim: str, seen: str) -> None:
        self.what, self.claim, self.seen = what, claim, seen
        super().__init__(f"{what} breaks its contract: {claim}; found {seen}")


# --- agents and training ---------------------------------------------------------------


class AgentSettingsError(ConfigError):
    """A setting of an agent or of a training run is not valid."""


class UnsupportedSpaceError(EscapeError, ValueError):
    """An agent does not support this observation or action space. The message names the supported ones."""


class StepContractError(EscapeError, ValueError):
    """An environment's `step` or `reset` violates the SMDP contract of `info`."""


class DiscountMismatchError(EscapeError, ValueError):
    """The environment discounts with another gamma than the agent.

    Attributes:
        agent_gamma: the agent's discount per primitive.
        env_discount: value of `info["discount"]`.
        duration: number of primitives in that step.
    """

    def __init__(self, agent_gamma: float, env_discount: float, duration: int) -> None:
        self.agent_gamma, self.env_discount, self.duration = agent_gamma, env_discount, duration
        env_gamma = max(env_discount, 0.0) ** (1 / duration)
        super().__init__(
            f"the agent's gamma is {agent_gamma:g} but the environment discounts by {env_gamma:g} per primitive "
            f"(info['discount'] = {env_discount:g} after {duration}). Give both the same gamma, or let the "
            "environment put the primitive rewards into info['rewards'], which suits any gamma"
        )


class DivergenceError(EscapeError, ArithmeticError):
    """A loss or its gradient became NaN or infinite, and training cannot continue.

    Attributes:
        agent: name of the algorithm.
        updates: number of gradient steps before it happened.
        run: name of the run, if known.
        primitives: number of training primitives before it happened, if known.
        loss: the loss.
        gradient_norm: Euclidean norm of the gradient, or None if the loss itself is not finite.
    """

    def __init__(self, agent: str, updates: int, run: str = "", primitives: int | None = None,
                 loss: float = math.nan, gradient_norm: float | None = None) -> None:
        self.agent, self.updates, self.run, self.primitives = agent, updates, run, primitives
        self.loss, self.gradient_norm = loss, gradient_norm
        where = f"{run}: " if run else ""
        when = "" if primitives is None else f", primitive {primitives}"
        what = (f"the loss of {agent} is no longer a finite number" if gradient_norm is None else
                f"the gradient of {agent} is no longer finite, of norm {gradient_norm:g} at a loss of {loss:.3g}")
        super().__init__(
            f"{where}{what} (update {updates}{when}). "
            "Lower learning_rate, set max_grad_norm, or look for rewards and observations of extreme size"
        )


class TrustError(EscapeError, ValueError):
    """A run's folder refers to code outside this package and its plugins. That code was not run.

    Attributes:
        names: what would be imported, each as `module:name`, or started.
    """

    def __init__(self, names: Iterable[object], would: str = "this run would import and call") -> None:
        self.names = tuple(names)
        shown = ", ".join(map(show_value, self.names[:8]))
        more = f" and {len(self.names) - 8} more" if len(self.names) > 8 else ""
        super().__init__(f"{would} {shown}{more}, which may do anything on this machine. If you trust where it comes "
                         "from, allow it by trust=True (--trust)")


class CheckpointError(FileReadError):
    """A checkpoint or log of a run is damaged, or was written by other software."""


def describe_damage(error: Exception) -> str:
    """Return the reason for an error from reading damaged content, in words."""
    if isinstance(error, KeyError) and not isinstance(error, EscapeError):
        return f"{show_value(error.args[0] if error.args else '')} is missing"
    return str(error)[:300] or type(error).__name__


class RunMismatchError(EscapeError, ValueError):
    """A run's folder contains another run. The message names the differences."""


class RunBusyError(EscapeError, RuntimeError):
    """Another process is training in the same folder."""


# --- options and planners --------------------------------------------------------------


class GoalError(EscapeError, ValueError):
    """The goal of a planning request is not valid. The message shows the syntax of goals."""


class OptionError(EscapeError, ValueError):
    """An option, or a set of options, is not valid. The message gives the reason."""


class PathPlannerError(EscapeError, RuntimeError):
    """A path planner failed, returned no path, or was registered under a name in use."""


class PlanningReason(str, enum.Enum):
    """All reasons for a failed plan."""

    START_INVALID = "start invalid"
    GOAL_INVALID = "goal invalid"
    UNREACHABLE_PROVEN = "unreachable, proven"
    UNREACHABLE_AT_RESOLUTION = "unreachable at this resolution"
    NO_POSTURE = "no posture"
    TIMEOUT = "timeout"
    CANCELLED = "cancelled"
    BUDGET_EXHAUSTED = "budget exhausted"
    PRECONDITION_UNMET = "puzzle precondition unmet"


class PlanningFailed(EscapeError, RuntimeError):  # noqa: N818  # an outcome that callers handle, not a defect
    """A planner found no plan.

    Attributes:
        reason: one of `PlanningReason`.
        goal: the requested goal, in words.
        start: start pose of the base (x, y, heading), m and rad; None if no base moves.
        seconds: wall time of the attempt.
        planners: planners that were tried, in order.
        nearest: the closest result, in words; empty if unknown.
        advice: what the caller can do.
        expansions: number of expanded search nodes.
    """

    def __init__(
        self,
        reason: PlanningReason,
        goal: str,
        start: tuple[float, float, float] | None = None,
        seconds: float = 0.0,
        planners: tuple[str, ...] = (),
        nearest: str = "",
        advice: str = "",
        expansions: int = 0,
    ) -> None:
        self.reason, self.goal, self.start, self.seconds = PlanningReason(reason), goal, start, seconds
        self.planners, self.nearest, self.advice, self.expansions = planners, nearest, advice, expansions
        pose = "" if start is None else " from ({:.2f}, {:.2f}) heading {:.2f} rad".format(*start)
        tried = f"; tried {', '.join(planners)} for {seconds:.2f} s" if planners else ""
        super().__init__(
            f"no plan for {goal}{pose}: {self.reason.value}{tried}"
            + (f"; nearest: {nearest}" if nearest else "")
            + (f". {advice}" if advice else "")
        )


# --- the batched engine ----------------------------------------------------------------


class BatchError(EscapeError, ValueError):
    """A tensor passed to the batched engine has the wrong shape, dtype or device.

    Attributes:
        name: name of the argument.
        given: shape, dtype and device of the tensor, in words.
        allowed: valid tensors, in words.
    """

    def __init__(self, name: str, value: object, allowed: str) -> None:
        self.name, self.value, self.allowed = name, value, allowed
        parts: list[Any] = [getattr(value, word, None) for word in ("shape", "dtype", "device")]
        shape, dtype, device = parts
        self.given = f"a {type(value).__name__}" if shape is None else f"{tuple(shape)}, {dtype}, on {device}"
        super().__init__(f"{name} is {self.given}; the batch takes {allowed}")


# --- comparison ------------------------------------------------------------------------


class GridError(EscapeError, ValueError):
    """A grid is not valid: it is empty, names something twice, or cannot be read."""


class ComparisonError(EscapeError, RuntimeError):
    """A comparison has no result to report: every run failed, or a room has no best known return."""


# --- the ladder ------------------------------------------------------------------------


class VerificationError(EscapeError, ValueError):
    """Content differs from its published hash: the rooms of a benchmark, or a recording."""


# --- services --------------------------------------------------------------------------


class EndpointError(EscapeError, RuntimeError):
    """The endpoint of a language model refuses requests, or does not answer them."""


class AddressError(EscapeError, OSError):
    """The viewer cannot listen on an address: its port is in use, or it belongs to another machine."""


class EpisodeFileError(EscapeError, ValueError):
    """A file is not a recorded episode, or its replay differs from the record."""
