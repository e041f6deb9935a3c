"""Data sets of decisions: recordings that replay exactly, and what learners and other libraries read from them."""

from __future__ import annotations

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
