"""Benchmarks: rungs by name, each with its sets of rooms, from a manifest of a few kB."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

from hrl_escape.errors import UnknownNameError
from hrl_escape.ladder.certificate import certify_rung
from hrl_escape.ladder.manifest import Manifest, list_benchmarks, load_manifest
from hrl_escape.ladder.rung import Rung

__all__ = ["Benchmark", "list_benchmarks", "load_benchmark"]


class Benchmark:
    """Rungs by name: `bench["lattice"].train`. The source is the name or file that `load_benchmark` finds it by."""

    def __init__(self, manifest: Manifest, source: str = "") -> None:
        self.manifest, self.name, self.source = manifest, manifest.name, source or manifest.name
        self._rungs = {record.name: Rung(manifest.name, record, self.source, manifest.hidden_round, manifest.layouts)
                       for record in manifest.rungs}

    def __repr__(self) -> str:
        return f"<Benchmark {self.name}: {', '.join(self._rungs)}>"

    def __len__(self) -> int:
        return len(self._rungs)

    def __iter__(self) -> Iterator[Rung]:
        return iter(self._rungs.values())

    def __getitem__(self, name: str) -> Rung:
        if name not in self._rungs:
            raise UnknownNameError(f"rung of {self.name}", name, self._rungs)
        return self._rungs[name]

    def verify(self, rungs: Iterable[str] = (), report: Callable[[str], None] = lambda line: None) -> None:
        """Generate rungs anew and check roots and disjointness; about 10 ms a room, 100 ms in the largest.

        Args:
            rungs: names; all by default.
            report: takes one line a rung as it passes.

        Raises:
            VerificationError: something differs; the message says what.
        """
        for rung in [self[name] for name in rungs] or self:
            report(str(certify_rung(rung)))


def load_benchmark(name: str | Path) -> Benchmark:
    """Load a benchmark that comes with the package, or one from a manifest file.

    Raises:
        UnknownNameError: there is none of that name.
        EscapeError: the file is damaged.
    """
    return Benchmark(load_manifest(name), str(name))
