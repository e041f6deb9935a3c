"""The base of every check: claims about one implementation, the first that fails is raised."""

from __future__ import annotations

import json
from typing import Any

import numpy as np

from hrl_escape.errors import ContractError


class Claims:
    """Claims about one implementation, as error messages name it, such as `puzzle 'buttons'`."""

    def __init__(self, name: str) -> None:
        self.name = name

    def require(self, holds: bool, claim: str, seen: object) -> None:
        """Raise `ContractError` unless a claim holds; `seen` is quoted as the evidence."""
        if not holds:
            raise ContractError(self.name, claim, repr(seen))


def dump_state(agent: Any) -> str:
    """An agent's state as text that is equal where all numbers are."""
    return json.dumps(agent.state_dict(), default=_encode, sort_keys=True)


def _encode(value: Any) -> Any:
    if isinstance(value, np.generic):
        return value.item()
    detached = value.detach().cpu().numpy() if type(value).__module__.startswith("torch") else np.asarray(value)
    return [str(detached.dtype), detached.shape, detached.tobytes().hex()]
