"""Bugs of the ladder: sets of rooms, their keys and their certificates."""

from tests.mutations.mutation import Mutation

MUTATIONS = [
    Mutation(
        "rooms of the same task are no overlap with test_task",
        "ladder/certificate.py",
        'if key == "task" and "test_task" not in (first, second):',
        'if key == "task":',
        "ladder/test_certificate.py",
    ),
    Mutation(
        "rooms of the same layout are no overlap",
        "ladder/certificate.py",
        'for key in ("content", "layout", "task"):',
        'for key in ("content", "task"):',
        "ladder/test_certificate.py",
    ),
    Mutation(
        "the task overlap is a share of the training rooms",
        "ladder/certificate.py",
        "return sum(keys.task in known for keys in test) / len(test)",
        "return sum(keys.task in known for keys in test) / len(train)",
        "ladder/test_certificate.py",
    ),
    Mutation(
        "a wrong root passes",
        "ladder/certificate.py",
        "if root != (stated := getattr(rung.record, role).root)]",
        "if not (stated := getattr(rung.record, role).root)]",
        "ladder/test_certificate.py",
    ),
    Mutation(
        "directions of edges do not matter to a canonical form",
        "ladder/canonical.py",
        "tuple(sorted((numbers[a], numbers[b]) for a, b in self._edges))",
        "tuple(sorted(tuple(sorted((numbers[a], numbers[b]))) for a, b in self._edges))",
        "ladder/test_canonical.py ladder/test_keys.py",
    ),
]
