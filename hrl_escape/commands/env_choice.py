"""Options that choose an environment from elsewhere, shared by commands; not a command."""

from __future__ import annotations

import dataclasses

from hrl_escape.benchmark.env_spec import EnvSpec
from hrl_escape.errors import UnsupportedError


@dataclasses.dataclass(frozen=True, kw_only=True)
class EnvChoice:
    """Options that choose an environment from elsewhere, inherited by dataclasses of commands."""

    env: str | None = None
    """Environment from elsewhere, in place of rooms: a Gymnasium id, or a function as file.py:function."""
    options: str = ""
    """Options in --env, as file.py:function: a function from the environment to its options."""

    def make_env_spec(self, reference: float | None = None) -> EnvSpec | None:
        """Return the environment, or None if rooms are chosen.

        Args:
            reference: return for comparison.

        Raises:
            UnsupportedError: options or a reference without an environment.
        """
        if self.env is not None:
            return EnvSpec(self.env, self.options, reference=reference)
        if self.options or reference is not None:
            raise UnsupportedError(f"{'--options' if self.options else '--reference'} is for --env; the options of "
                                   "rooms are part of an agent's spec, such as smdp-dqn+reactive")
        return None
