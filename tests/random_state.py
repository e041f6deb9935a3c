"""Finds uses of global random state in Python source: the lint rule behind "same seeds, same numbers".

It reads the syntax tree and runs nothing. Names are followed through imports and `as`, not assignments.
"""

from __future__ import annotations

import ast
from collections.abc import Iterable
from functools import cache

parse = cache(ast.parse)
"""Syntax tree of a source, which several rules read."""


@cache
def list_nodes(source: str) -> tuple[ast.AST, ...]:
    """All nodes of that tree."""
    return tuple(ast.walk(parse(source)))


NUMPY_ALLOWED = {
    *("default_rng", "RandomState", "Generator", "SeedSequence", "BitGenerator"),
    "get_state",  # reading tells whether somebody has drawn
    *("PCG64", "PCG64DXSM", "Philox", "SFC64", "MT19937"),
}
NUMPY_SEEDED = {"default_rng", "RandomState"}
TORCH_GLOBAL = {
    *("torch.manual_seed", "torch.seed", "torch.initial_seed", "torch.set_rng_state"),
    *("torch.default_generator", "torch.random"),
}
TORCH_SAMPLERS = {
    *("torch.rand", "torch.randn", "torch.randint", "torch.randperm", "torch.normal", "torch.bernoulli"),
    *("torch.multinomial", "torch.poisson", "torch.rand_like", "torch.randn_like", "torch.randint_like"),
    *(f"torch.nn.init.{name}_" for name in ("uniform", "normal", "trunc_normal", "orthogonal", "sparse")),
    *(f"torch.nn.init.{family}_{law}_" for family in ("xavier", "kaiming") for law in ("uniform", "normal")),
}
TENSOR_SAMPLERS = {
    f"{name}_" for name in "uniform normal random bernoulli exponential geometric cauchy log_normal".split()
}


def find_global_random_state(source: str) -> list[str]:
    """Returns one line `number: name` for each use of a random stream that the caller does not own."""
    if not any(word in source for word in ("random", "torch", *TENSOR_SAMPLERS)):
        return []
    nodes = list_nodes(source)
    names = _imported_names(nodes)
    calls = {id(node.func): node for node in nodes if isinstance(node, ast.Call)}
    parts = {id(node.value) for node in nodes if isinstance(node, ast.Attribute)}
    found = []
    for node in nodes:
        if isinstance(node, ast.Attribute | ast.Name) and id(node) not in parts:
            name, call = _dotted(node, names), calls.get(id(node))
            if _is_global(name, call) or _is_global_tensor_method(node, name, call):
                found.append((node.lineno, name))
    return [f"{line}: {name}" for line, name in sorted(found)]


def _imported_names(nodes: Iterable[ast.AST]) -> dict[str, str]:
    names = {}
    for node in nodes:
        if isinstance(node, ast.Import):
            for alias in node.names:
                names[alias.asname or alias.name.partition(".")[0]] = (
                    alias.name if alias.asname else alias.name.partition(".")[0]
                )
        elif isinstance(node, ast.ImportFrom) and not node.level:
            names |= {alias.asname or alias.name: f"{node.module}.{alias.name}" for alias in node.names}
    return names


def _dotted(node: ast.expr, names: dict[str, str]) -> str:
    if isinstance(node, ast.Attribute):
        return f"{_dotted(node.value, names)}.{node.attr}"
    return names.get(node.id, f"<{node.id}>") if isinstance(node, ast.Name) else "<value>"


def _is_global(name: str, call: ast.Call | None) -> bool:
    root, _, rest = name.partition(".")
    if root == "random":
        return not (rest == "Random" and _has_arguments(call))
    if name.startswith("numpy.random."):
        sampler = name.split(".")[2]
        return sampler not in NUMPY_ALLOWED or (sampler in NUMPY_SEEDED and not _has_arguments(call))
    if name in TORCH_SAMPLERS:
        return not _has_generator(call)
    return any(name == banned or name.startswith(f"{banned}.") for banned in TORCH_GLOBAL) or (
        name.startswith("torch.cuda.") and ("seed" in name or "rng_state" in name)
    )


def _is_global_tensor_method(node: ast.expr, name: str, call: ast.Call | None) -> bool:
    if not (isinstance(node, ast.Attribute) and call) or name.startswith("torch.nn.init."):
        return False
    return node.attr in TENSOR_SAMPLERS and not _has_generator(call)


def _has_arguments(call: ast.Call | None) -> bool:
    return call is not None and bool(call.args or call.keywords)


def _has_generator(call: ast.Call | None) -> bool:
    return call is not None and any(keyword.arg == "generator" for keyword in call.keywords)
