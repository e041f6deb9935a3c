"""Hierarchies as programs: partial machines (Parr and Russell 1998) written as Python generators.

    @machine
    def press(seen, button):
        while not is_on(seen(), button):
            yield from go_to((yield choose(PANELS)))    # learned: which panel
            yield do(TURN_LEFT)                         # a primitive

`seen()` is the present moment. `yield choose(things)` is a choice point and returns the chosen thing;
`yield do(primitive)` acts; `yield from other(...)` calls another machine. The machine state is the whole stack of
running machines, each as (name, line, arguments). Other variables of a machine are not part of it, so
pass values that later choices depend on as arguments. The line counts from the machine's own first.
"""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Generator, Hashable, Sequence
from typing import Any, NamedTuple

from hrl_escape.agents.hierarchy.task import Seen
from hrl_escape.agents.hierarchy.task_graph import freeze
from hrl_escape.errors import StepContractError


class Choose(NamedTuple):
    """A choice point: the things to choose among, and a label if a line has several points."""

    things: Sequence[Any]
    label: str = ""


class Do(NamedTuple):
    """A primitive to do."""

    primitive: int


class _Look(NamedTuple):
    """A machine asks for `seen`."""


class MachineCall(NamedTuple):
    """One call on the stack of running machines."""

    name: str  # of the machine
    line: int  # present line, counted from its own first
    arguments: tuple[Any, ...]  # of its call
    primitives: int  # done since it was called


Program = Generator[Any, Any, Any]
Machine = Callable[..., Program]
"""A function decorated with `machine`; without arguments it can be the root."""


def choose(things: Sequence[Any], label: str = "") -> Choose:
    """Make a choice point to yield; a single thing needs no learning."""
    return Choose(tuple(things), label)


def do(primitive: int) -> Do:
    """Make a primitive to yield."""
    return Do(int(primitive))


def machine(function: Callable[..., Program]) -> Machine:
    """Make a machine of a generator function whose first argument is `seen`, which callers omit."""

    @functools.wraps(function)
    def call(*arguments: Any) -> Program:
        seen = yield _Look()
        return (yield from function(seen, *arguments))

    return call


def find_machines(root: Machine) -> dict[str, Machine]:
    """Machines that a program can call, by name: itself, and the machines that its functions name in any scope."""
    found: dict[str, Machine] = {}
    left: list[Any] = [root]
    while left:
        each = left.pop()
        function = getattr(each, "__wrapped__", None)
        if not inspect.isgeneratorfunction(function) or function.__name__ in found:
            continue
        found[function.__name__] = each
        named = inspect.getclosurevars(function)
        left += [value for value in (*named.nonlocals.values(), *named.globals.values()) if callable(value)]
    return found


Input = Seen | int
"""Input of a run: a moment, at its start and after each primitive, or the index of a choice."""


class MachineRun:
    """One run of a machine, from the beginning of an episode.

    A generator cannot be copied, so a run keeps all its inputs: `MachineRun(root, run.inputs[:n])` is the run after n
    of them.

    Args:
        callers: machine state of its callers; by default it is the root of a program, which must not return.

    Attributes:
        request: present request, or None before the first moment and after the machine returned.
    """

    def __init__(self, root: Callable[[], Program], inputs: Sequence[Input] = (),
                 callers: tuple[Hashable, ...] = ()) -> None:
        self.inputs: list[Input] = []
        self._callers = callers
        self.request: Choose | Do | None = None
        self._program = root()
        self._primitives = -1
        """Number of primitives so far; the first moment precedes them."""
        self._running: list[tuple[Any, int]] = []
        """Running machines, the outermost first, and the primitives done when each was called."""
        for each in inputs:
            self.tell(each)

    def tell(self, told: Input) -> None:
        """Send the moment reached, or the choice among the things.

        Raises:
            StepContractError: the machine yields something other than choices and primitives, has no choice, or has
                returned.
        """
        answer: Any = None
        if isinstance(told, Seen):
            self.seen, self._primitives = told, self._primitives + 1
        else:
            assert isinstance(self.request, Choose)
            answer = self.request.things[told]
        self.inputs.append(told)
        try:
            request = self._program.send(answer if len(self.inputs) > 1 else None)
            while isinstance(request, _Look):
                request = self._program.send(lambda: self.seen)
        except StopIteration:
            self.request = None
            if self._callers:
                return
            raise StepContractError("the root machine returned before the end of the episode; let it loop") from None
        if not isinstance(request, (Choose, Do)):
            raise StepContractError(f"a machine yielded {request!r}; it must yield choose(things) or do(primitive)")
        self.request = request
        self._note_calls()
        if isinstance(request, Choose) and not request.things:
            raise StepContractError(f"a machine has nothing to choose at {self.read_state()}")

    def _note_calls(self) -> None:
        programs = []
        program: Any = self._program
        while program is not None:
            if program.gi_code.co_filename != __file__:  # not the decorator's own
                programs.append(program)
            program = program.gi_yieldfrom
        kept = 0
        while kept < min(len(programs), len(self._running)) and programs[kept] is self._running[kept][0]:
            kept += 1
        self._running[kept:] = [(each, self._primitives) for each in programs[kept:]]

    def list_calls(self) -> tuple[MachineCall, ...]:
        """Return the running machines, the outermost first."""
        calls = []
        for program, began in self._running:
            frame, code = program.gi_frame, program.gi_code
            arguments = tuple(freeze(frame.f_locals[name]) for name in code.co_varnames[1 : code.co_argcount])
            calls.append(MachineCall(code.co_name, frame.f_lineno - code.co_firstlineno, arguments,
                                     self._primitives - began))  # fmt: skip
        return tuple(calls)

    def read_state(self) -> Hashable:
        """Return the machine state: (name, line, arguments) of each running machine, outermost first, and the label."""
        label = self.request.label if isinstance(self.request, Choose) else ""
        return (*self._callers, *(call[:3] for call in self.list_calls()), label)
