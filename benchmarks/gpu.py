"""Run all tests that need a GPU, then measure the GPU rows of the speed table, in ten minutes on one GPU.

    python -m benchmarks.gpu             # tests, then rates, appended to benchmarks/gpu.jsonl
    python -m benchmarks.gpu --tests     # only `pytest -m gpu`
    python -m benchmarks.gpu --quick     # two minutes: tests and small batches

Exit code 2 without a GPU that torch can use.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from pathlib import Path

HISTORY = Path(__file__).with_name("gpu.jsonl")
ROOT = Path(__file__).parents[1]


def main() -> int:
    """Return the exit code of the tests, or 2 without a GPU."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tests", action="store_true", help="run the tests only")
    parser.add_argument("--quick", action="store_true", help="small batches")
    arguments = parser.parse_args()
    import torch

    if not torch.cuda.is_available():
        print(f"no GPU: torch {torch.__version__} finds no CUDA device. Run this on a machine with one, with a CUDA "
              "build of torch.", file=sys.stderr)
        return 2
    tests = [sys.executable, "-m", "pytest", "-q", "-m", "gpu", "tests"]
    code = subprocess.run(tests, cwd=ROOT, check=False).returncode
    if code or arguments.tests:
        return code
    from benchmarks.many_environments import measure_options, measure_ours
    from benchmarks.speed import describe_run, make_table

    counts, rows = (4_096,) if arguments.quick else (4_096, 65_536), []
    for count in counts:
        for name in ("1 epoch", "10 epochs", "dqn"):
            rate = measure_ours(name, count, 128 * count, 1, "cuda")["wall"]
            rows.append({"name": f"{name}, {count:,} rooms", "value": rate, "unit": "primitives/s", "ratio": None})
        rate = measure_options("own pace, compiled", count, "PaperTwoButton", True, "cuda")["wall"]
        rows.append({"name": f"options by body, {count:,} rooms", "value": rate, "unit": "options/s", "ratio": None})
    run = {**describe_run(), "gpu": torch.cuda.get_device_name(), "rows": rows}
    with HISTORY.open("a", encoding="utf-8") as file:
        file.write(json.dumps(run) + "\n")
    print(f"{run['gpu']}. {make_table(run)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
