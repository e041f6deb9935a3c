"""The contracts as runnable checks, for this project's own implementations and for strangers'.

Each `check_*` exercises one implementation by random play and raises `ContractError` at the
first claim that does not hold. A check reads the public interface only; it proves nothing, but
what it misses has to hide well.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
