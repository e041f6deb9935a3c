"""Every exception a user of hrl_escape can meet, one class a cause.

Each message says what was wrong, where, and what would be valid. All derive from
`EscapeError`, so that one `except` catches whatever this package raises on purpose.
"""

from __future__ import annotations

import difflib
import enum
from collections.abc import Iterable


class EscapeError(Exception):
    """Base of every error that hrl_escape raises on purpose."""


# --- rooms -----------------------------------------------------------------------------


class ConfigError(EscapeError, ValueError):
    """A value in a schematic is impossible.

    Attributes:
        field: dotted path of the field, such as `robot.body_radius`.
        value: the offending value.
        allowed: what would have been valid, in words.
    """

    def __init__(self, field: str, value: object, allowed: str) -> None:
        self.field, self.value, self.allowed = field, value, allowed
        super().__init__(f"{field} = {value!r} is not possible: {allowed}")

    def __reduce__(self) -> tuple[type, tuple]:
        return type(self), (self.field, self.value, self.allowed)


class GenerationError(EscapeError, RuntimeError):
    """No solvable room was found for a schematic within the bounded number of tries.

    Attributes:
        constraint: the constraint that failed last.
        tries: how many rooms were sampled.
    """

    def __init__(self, constraint: str, tries: int, advice: str) -> None:
        self.constraint, self.tries, self.advice = constraint, tries, advice
        super().__init__(f"no solvable room in {tries} tries; the last failed at: {constraint}. {advice}")

    def __reduce__(self) -> tuple[type, tuple]:
        return type(self), (self.constraint, self.tries, self.advice)


class InstanceFileError(EscapeError, ValueError):
    """A file does not hold a room instance this version can read."""


class RobotError(EscapeError, ValueError):
    """A robot's URDF is missing, unreadable, or lacks what the room needs of it."""


class UnknownNameError(EscapeError, KeyError):
    """A name is not registered; the message lists what is, closest first."""

    def __init__(self, what: str, name: object, known: Iterable[str]) -> None:
        self.what, self.name, self.known = what, name, tuple(sorted(known))
        close = difflib.get_close_matches(str(name), self.known, n=1)
        hint = f" Perhaps you meant {close[0]!r}." if close else ""
        self.message = f"unknown {what} {name!r}.{hint} Known: {', '.join(self.known) or 'none'}"
        super().__init__(self.message)

    def __str__(self) -> str:
        return self.message

    def __reduce__(self) -> tuple[type, tuple]:
        return type(self), (self.what, self.name, self.known)


class ActionError(EscapeError, ValueError):
    """An action is outside the action space."""

    def __init__(self, action: object, count: int) -> None:
        self.action, self.count = action, count
        super().__init__(f"action {action!r} is not one of 0 to {count - 1}")

    def __reduce__(self) -> tuple[type, tuple]:
        return type(self), (self.action, self.count)


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
        super().__init__(f"{purpose} needs {package}: pip install 'hrl-escape[{extra}]'")

    def __reduce__(self) -> tuple[type, tuple]:
        return type(self), (self.package, self.extra, self.purpose)


class FileWriteError(EscapeError, OSError):
    """A file could not be written (full disk, unwritable folder); nothing was half written."""


class FileReadError(EscapeError, OSError):
    """A file is missing, truncated or not what its name says."""


class PluginError(EscapeError, ImportError):
    """An installed package offers something through an entry point that cannot be loaded."""


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

    def __reduce__(self) -> tuple[type, tuple]:
        return type(self), (self.what, self.claim, self.seen)


# --- agents and training ---------------------------------------------------------------


class AgentSettingsError(ConfigError):
    """A setting of an agent or of a training run is impossible."""


class UnsupportedSpaceError(EscapeError, ValueError):
    """An agent cannot act in this observation or action space; the message says what it can."""


class StepContractError(EscapeError, ValueError):
    """What an environment's `step` or `reset` returned breaks the SMDP contract of `info`."""


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

    def __reduce__(self) -> tuple[type, tuple]:
        return type(self), (self.agent_gamma, self.env_discount, self.duration)


class DivergenceError(EscapeError, ArithmeticError):
    """A loss became NaN or infinite: the agent cannot go on learning.

    Attributes:
        agent: the algorithm's name.
        updates: gradient steps made before it happened.
        run: which run, once known.
        primitives: primitives trained for, once known.
    """

    def __init__(self, agent: str, updates: int, run: str = "", primitives: int | None = None) -> None:
        self.agent, self.updates, self.run, self.primitives = agent, updates, run, primitives
        where = f"{run}: " if run else ""
        when = "" if primitives is None else f", primitive {primitives}"
        super().__init__(
            f"{where}the loss of {agent} is no longer a finite number (update {updates}{when}). "
            "Lower learning_rate, set max_grad_norm, or look for rewards and observations of extreme size"
        )

    def __reduce__(self) -> tuple[type, tuple]:
        return type(self), (self.agent, self.updates, self.run, self.primitives)


class CheckpointError(FileReadError):
    """A checkpoint or log of a run is damaged, or was written by something else."""


class RunMismatchError(EscapeError, ValueError):
    """A run's folder already holds a run with other settings."""


class RunBusyError(EscapeError, RuntimeError):
    """Another process is training into the same folder."""


class WorkerLostError(EscapeError, RuntimeError):
    """A process that trained some of several seeds is gone.

    Attributes:
        agent: the agent's name.
        seeds: those it was training.
        exit_code: what the system says of its end; negative for a signal.
    """

    def __init__(self, agent: str, seeds: list[int], exit_code: int | None) -> None:
        self.agent, self.seeds, self.exit_code = agent, seeds, exit_code
        listed = ", ".join(map(str, seeds))
        super().__init__(
            f"{agent}, seeds {listed}: their process ended with code {exit_code} before they were trained; the machine "
            "may have run out of memory. With out= the same call goes on from their checkpoints; fewer workers or "
            "trials need less memory"
        )

    def __reduce__(self) -> tuple[type, tuple]:
        """Pickle by the constructor's arguments."""
        return type(self), (self.agent, self.seeds, self.exit_code)


# --- options and planners --------------------------------------------------------------


class GoalError(EscapeError, ValueError):
    """What a planner was asked to reach is no goal: the message says how goals are written."""


class OptionError(EscapeError, ValueError):
    """An option, or a set of options, cannot be what it claims; the message says why."""


class PathPlannerError(EscapeError, RuntimeError):
    """A path planner failed, returned something that is no path, or was registered under a name in use."""


class PlanningReason(str, enum.Enum):
    """Why a plan could not be made; the whole list."""

    START_INVALID = "start invalid"
    GOAL_INVALID = "goal invalid"
    UNREACHABLE_PROVEN = "unreachable, proven"
    UNREACHABLE_AT_RESOLUTION = "unreachable at this resolution"
    NO_POSTURE = "no posture"
    TIMEOUT = "timeout"
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
    ) -> None:
        self.reason, self.goal, self.start, self.seconds = PlanningReason(reason), goal, start, seconds
        self.planners, self.nearest, self.advice = planners, nearest, advice
        x, y, heading = start
        tried = f"; tried {', '.join(planners)} for {seconds:.2f} s" if planners else ""
        super().__init__(
            f"no plan to {goal} from ({x:.2f}, {y:.2f}) heading {heading:.2f} rad: {self.reason.value}{tried}"
            + (f"; nearest: {nearest}" if nearest else "")
            + (f". {advice}" if advice else "")
        )

    def __reduce__(self) -> tuple[type, tuple]:
        return type(self), (self.reason, self.goal, self.start, self.seconds, self.planners, self.nearest,
                            self.advice)


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
        shape, dtype, device = (getattr(value, word, None) for word in ("shape", "dtype", "device"))
        self.given = f"a {type(value).__name__}" if shape is None else f"{tuple(shape)}, {dtype}, on {device}"  # type: ignore[arg-type]
        super().__init__(f"{name} is {self.given}; the batch takes {allowed}")


# --- experiments -----------------------------------------------------------------------


class GridError(EscapeError, ValueError):
    """A comparison cannot be what it says: nothing to run, the same thing twice, or an unreadable file."""


class ComparisonError(EscapeError, RuntimeError):
    """A comparison has no result to report: every run failed, or a room has no known best return."""


# --- the viewer ------------------------------------------------------------------------


class AddressError(EscapeError, OSError):
    """The viewer cannot listen where it was asked to: the port is taken, or the address is not this machine's."""


class EpisodeFileError(EscapeError, ValueError):
    """A file holds no recorded episode, or one that does not play out as it says."""
