"""Results that come with the frozen sets: reference efficiencies, and trained agents (`comparison.load_pretrained`)."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
