"""Bugs of checks, commands, and what stands at the package's root."""

from tests.mutations.mutation import Mutation

MUTATIONS = [
    Mutation(
        "check_puzzle believes operators",
        "checks/puzzle.py",
        "expected = op.apply(facts)",
        "expected = after",
        "checks/test_checks.py",
    ),
    Mutation(
        "check_puzzle lets presses count in any order",
        "checks/puzzle.py",
        "self.require(after == one_by_one,",
        "self.require(True,",
        "checks/test_checks.py",
    ),
    Mutation(
        "check_puzzle lets a rule change its state in place",
        "checks/puzzle.py",
        "self.require(after == again and hash(state) == before,",
        "self.require(True,",
        "checks/test_checks.py",
    ),
    Mutation(
        "check_option believes is_markov",
        "checks/option.py",
        "if self.option.is_markov:",
        "if False:",
        "options/test_option.py",
    ),
    Mutation(
        "a file is not on the disk when it takes its name",
        "files.py",
        "            os.fsync(descriptor)\n        os.replace",
        "        os.replace",
        "test_files.py",
    ),
]
