"""Checks of the contracts of puzzles, options, agents, hierarchies and path planners.

Each `check_*` function exercises one implementation by random play, through its public interface, and raises
`ContractError` for the first violated requirement.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
