"""Base of all checks: requirements of one implementation."""

from __future__ import annotations

import json
from typing import Any

import numpy as np

from hrl_escape.errors import ContractError


class Claims:
    """Requirements of an implementation, which messages call by a name such as `puzzle 'buttons'`."""

    def __init__(self, name: str) -> None:
        self.name = name

    def require(self, holds: bool, claim: str, seen: object) -> None:
        """Raise `ContractError` unless a requirement holds; the message quotes `seen`."""
        if not holds:
            raise ContractError(self.name, claim, repr(seen))


def dump_state(agent: Any) -> str:
    """Return an agent's state as text for exact comparison."""
    return json.dumps(agent.state_dict(), default=_encode, sort_keys=True)


def _encode(value: Any) -> Any:
    if isinstance(value, np.generic):
        return value.item()
    detached = value.detach().cpu().numpy() if type(value).__module__.startswith("torch") else np.asarray(value)
    return [str(detached.dtype), detached.shape, detached.tobytes().hex()]
