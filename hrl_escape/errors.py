"""Exceptions of hrl_escape, one class a cause.

Each message names the mistake, its place, and what would be valid. All derive from
`EscapeError`, so that one `except` catches everything this package raises on purpose.
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
    """Base of every error that hrl_escape raises on purpose; a worker's errors reach the parent process whole."""

    def __new__(cls, *given: Any, **named: Any) -> Self:
        """Keep the arguments, of which a copy in another process is made."""
        made: Any = super().__new__(cls, *given)
        made._given = given, named
        return made

    def __reduce__(self) -> tuple[Any, tuple]:
        given, named = vars(self)["_given"]
        return functools.partial(type(self), **named), given


_SHORT = reprlib.Repr()
_SHORT.maxstring = _SHORT.maxother = 200
_SHORT.maxlist = _SHORT.maxtuple = _SHORT.maxdict = 12


def show_value(value: object) -> str:
    """Value as Python writes it, cut where it is long."""
    try:
        return _SHORT.repr(value)
    except ValueError:  # a whole number of more digits than Python writes
        return "a number of thousands of digits"


def name_install(extra: str) -> str:
    """Command that installs an extra: from a checkout, for no package is published."""
    return f"pip install -c constraints.txt '.[{extra}]' in a checkout of hrl-escape"


# --- rooms -----------------------------------------------------------------------------


class ConfigError(EscapeError, ValueError):
    """A value in a room configuration is impossible.

    Attributes:
        field: dotted path of the field, such as `robot.body_radius`.
        value: the offending value.
        allowed: what would have been valid, in words.
    """

    def __init__(self, field: str, value: object, allowed: str) -> None:
        self.field, self.value, self.allowed = field, value, allowed
        super().__init__(f"{field} = {show_value(value)} is not possible: {allowed}")


class GenerationError(EscapeError, RuntimeError):
    """No solvable room was found for a room configuration within the bounded number of tries.

    Attributes:
        constraint: the constraint that failed last.
        tries: how many rooms were sampled.
    """

    def __init__(self, constraint: str, tries: int, advice: str) -> None:
        self.constraint, self.tries, self.advice = constraint, tries, advice
        super().__init__(f"no solvable room in {tries} tries; the last failed at: {constraint}. {advice}")


class InstanceFileError(EscapeError, ValueError):
    """A file does not hold a room instance this version can read."""


class RobotError(EscapeError, ValueError):
    """A robot's URDF is missing, unreadable, or lacks what the room needs of it."""


class UnknownNameError(EscapeError, KeyError):
    """A name is unknown; the message gives the closest known name, then all, and a note where there is more to say."""

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
    """`step` was called before the first `reset`, or after an episode ended."""


class StateError(EscapeError, ValueError):
    """A state does not belong to this room."""


class ClosedError(EscapeError, RuntimeError):
    """The room was closed and can no longer be used."""


class UnsupportedError(EscapeError, ValueError):
    """Two valid settings do not go together; the message names what to use instead."""


class MissingExtraError(EscapeError, ImportError):
    """An optional package is not installed; the message names the extra that brings it."""

    def __init__(self, package: str, extra: str, purpose: str) -> None:
        self.package, self.extra, self.purpose = package, extra, purpose
        super().__init__(f"{purpose} needs {package}: {name_install(extra)}")


class MissingPackageError(EscapeError, ImportError):
    """A package of the default installation is missing or cannot be loaded; rooms step without it."""

    def __init__(self, package: str, purpose: str, reason: ImportError) -> None:
        self.package, self.purpose = package, purpose
        super().__init__(f"{purpose} needs the package {package}, which cannot be imported ({reason}): pip install "
                         f"-c constraints.txt {package} in a checkout of hrl-escape. Rooms step without it")


class FileWriteError(EscapeError, OSError):
    """A file could not be written (full disk, unwritable folder); nothing was half written."""


class FileReadError(EscapeError, OSError):
    """A file is missing, truncated or of another kind than its name says."""


class OldFormatError(FileReadError):
    """A file is of version 0.3; the message names the command that converts it."""

    def __init__(self, path: object, what: str) -> None:
        self.message = (f"{path}: this {what} is of version 0.3. `hrl-escape convert {path}` writes it in the form of "
                        "this version")
        super().__init__(self.message)

    def __str__(self) -> str:
        return self.message  # an OSError of two arguments would show a number and a text


class PluginError(EscapeError, ImportError):
    """An entry point of an installed package cannot be loaded."""


class ContractError(EscapeError, AssertionError):
    """A check found that an implementation breaks its interface's contract.

    Attributes:
        what: the implementation that was checked.
        claim: what must hold.
        seen: what was found instead.
    """

    def __init__(self, what: str, claim: str, seen: str) -> None:
        self.what, self.claim, self.seen = what, claim, seen
        super().__init__(f"{what} breaks its contract: {claim}; found {seen}")


# --- agents and training ---------------------------------------------------------------


class AgentSettingsError(ConfigError):
    """A setting of an agent or of a training run is impossible."""


class UnsupportedSpaceError(EscapeError, ValueError):
    """An agent does not support this observation or action space; the message names those it supports."""


class StepContractError(EscapeError, ValueError):
    """An environment's `step` or `reset` breaks the SMDP contract of `info`."""


class DiscountMismatchError(EscapeError, ValueError):
    """The environment discounts by another gamma than the agent learns with.

    Attributes:
        agent_gamma: the agent's discount per primitive.
        env_discount: `info["discount"]` as given.
        duration: primitives in that step.
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
    """A loss or its gradient became NaN or infinite, so that the agent cannot go on learning.

    Attributes:
        agent: the algorithm's name.
        updates: gradient steps made before it happened.
        run: which run, once known.
        primitives: primitives trained for, once known.
        loss: the loss.
        gradient_norm: Euclidean norm of its gradient; None where the loss itself is not finite.
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
    """A run's folder names code that is neither this package's nor registered; nothing was run.

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
    """A checkpoint or log of a run is damaged, or was written by something else."""


def describe_damage(error: Exception) -> str:
    """Reason in words for an error that reading damaged content has raised."""
    if isinstance(error, KeyError) and not isinstance(error, EscapeError):
        return f"{show_value(error.args[0] if error.args else '')} is missing"
    return str(error)[:300] or type(error).__name__


class RunMismatchError(EscapeError, ValueError):
    """A run's folder holds another run; the message names what differs."""


class RunBusyError(EscapeError, RuntimeError):
    """Another process is training into the same folder."""


# --- options and planners --------------------------------------------------------------


class GoalError(EscapeError, ValueError):
    """A planner was asked to reach something that is no goal; the message shows how goals are written."""


class OptionError(EscapeError, ValueError):
    """An option, or a set of options, is impossible; the message says why."""


class PathPlannerError(EscapeError, RuntimeError):
    """A path planner failed, returned no path, or was registered under a name in use."""


class PlanningReason(str, enum.Enum):
    """Reasons for which planning fails, complete."""

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
        reason: why, one of `PlanningReason`.
        goal: what was asked for, in words.
        start: pose (x, y, heading) it was asked from, m and rad.
        seconds: wall time spent.
        planners: the planners that were tried, in order.
        nearest: what came closest, in words; empty where nothing is known.
        advice: what to do about it.
        expansions: search nodes expanded in vain.
    """

    def __init__(
        self,
        reason: PlanningReason,
        goal: str,
        start: tuple[float, float, float],
        seconds: float = 0.0,
        planners: tuple[str, ...] = (),
        nearest: str = "",
        advice: str = "",
        expansions: int = 0,
    ) -> None:
        self.reason, self.goal, self.start, self.seconds = PlanningReason(reason), goal, start, seconds
        self.planners, self.nearest, self.advice, self.expansions = planners, nearest, advice, expansions
        x, y, heading = start
        tried = f"; tried {', '.join(planners)} for {seconds:.2f} s" if planners else ""
        super().__init__(
            f"no plan for {goal} from ({x:.2f}, {y:.2f}) heading {heading:.2f} rad: {self.reason.value}{tried}"
            + (f"; nearest: {nearest}" if nearest else "")
            + (f". {advice}" if advice else "")
        )


# --- the batched engine ----------------------------------------------------------------


class BatchError(EscapeError, ValueError):
    """A tensor given to the batched engine has another shape, dtype or device than the batch.

    Attributes:
        name: which argument.
        given: what it was, in words.
        allowed: what would have been valid.
    """

    def __init__(self, name: str, value: object, allowed: str) -> None:
        self.name, self.value, self.allowed = name, value, allowed
        parts: list[Any] = [getattr(value, word, None) for word in ("shape", "dtype", "device")]
        shape, dtype, device = parts
        self.given = f"a {type(value).__name__}" if shape is None else f"{tuple(shape)}, {dtype}, on {device}"
        super().__init__(f"{name} is {self.given}; the batch takes {allowed}")


# --- comparison ------------------------------------------------------------------------


class GridError(EscapeError, ValueError):
    """A grid is impossible: it has nothing to run, names something twice, or cannot be read."""


class ComparisonError(EscapeError, RuntimeError):
    """A comparison has no result to report: every run failed, or a room has no best known return."""


# --- the ladder ------------------------------------------------------------------------


class VerificationError(EscapeError, ValueError):
    """Something is not what was published: a root or a set of a benchmark's rooms, or the content of a recording."""


# --- the viewer ------------------------------------------------------------------------


class AddressError(EscapeError, OSError):
    """The viewer cannot listen on an address: its port is taken, or it is not this machine's."""


class EpisodeFileError(EscapeError, ValueError):
    """A file holds no recorded episode, or one whose replay differs from its record."""
