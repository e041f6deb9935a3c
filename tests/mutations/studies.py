"""Planted bugs of the studies beside the package."""

from tests.mutations.mutation import Mutation

MUTATIONS = [
    Mutation(
        "a flat run that was given up counts as if it had arrived",
        "studies/price/ratios.py",
        "float(np.log(spent)) if has_arrived else np.inf",
        "float(np.log(spent))",
        "studies/test_price.py",
    ),
    Mutation(
        "a ratio's ends take both costs from the same side",
        "studies/price/ratios.py",
        "(paid[replicate][0] - others[replicate][1], paid[replicate][1] - others[replicate][0])",
        "(paid[replicate][0] - others[replicate][0], paid[replicate][1] - others[replicate][1])",
        "studies/test_price.py",
    ),
    Mutation(
        "the interval of a median leaves out one number too many",
        "studies/price/ratios.py",
        "outside = _count_outside(len(logs))",
        "outside = _count_outside(len(logs)) + 1",
        "studies/test_price.py",
    ),
    Mutation(
        "new results of a study take the place of all others",
        "studies/store.py",
        "text = read_text(self.path) if self.path.exists() else \"\"",
        "text = \"\"",
        "studies/test_store.py studies/test_scaling.py",
    ),
    Mutation(
        "being told otherwise is tested on one side",
        "studies/scaling/told.py",
        "p = 2 * min(compute",
        "p = min(compute",
        "studies/test_scaling.py",
    ),
    Mutation(
        "measures of difficulty are compared pair by pair, uncorrected",
        "studies/scaling/difficulty.py",
        "zip(pairs, correct_by_holm(p), strict=True)",
        "zip(pairs, [0.0] * len(p), strict=True)",
        "studies/test_scaling.py",
    ),
    Mutation(
        "runs in one room count as rooms",
        "studies/ladder/calibration.py",
        'rooms.setdefault(run.rooms, []).append',
        'rooms.setdefault(f"{run.rooms} {run.seed}", []).append',
        "studies/test_ladder.py",
    ),
    Mutation(
        "prices of flatness are told size by size, uncorrected",
        "studies/price/ratios.py",
        "ratio._replace(median=ratio.median._replace(p=next(p)))",
        "ratio",
        "studies/test_price.py",
    ),
    Mutation(
        "the best of many learned options is told as if it were alone",
        "studies/learned/dial.py",
        "1 - (1 - LEVEL) / (2 * len(chosen))",
        "LEVEL",
        "studies/test_dial.py",
    ),
    Mutation(
        "two processes of a study write its results at once",
        "studies/store.py",
        "with taking_turns(self.path.parent):",
        "if taking_turns(self.path.parent):",
        "studies/test_store.py",
    ),
    Mutation(
        "of two results of one run the first counts",
        "studies/store.py",
        "found[type(line), line.place] = line",
        "found.setdefault((type(line), line.place), line)",
        "studies/test_store.py",
    ),
]
