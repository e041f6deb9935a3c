"""The base of every check: claims about one implementation, the first that fails is raised."""

from __future__ import annotations

from hrl_escape.errors import ContractError


class Claims:
    """Claims about one implementation, as error messages name it, such as `puzzle 'buttons'`."""

    def __init__(self, name: str) -> None:
        self.name = name

    def require(self, holds: bool, claim: str, seen: object) -> None:
        """Raise `ContractError` unless a claim holds; `seen` is quoted as the evidence."""
        if not holds:
            raise ContractError(self.name, claim, repr(seen))
