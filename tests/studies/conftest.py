"""The small comparison, from which studies collect lines."""

from __future__ import annotations

from tests.comparison.conftest import finished

__all__ = ["finished"]
