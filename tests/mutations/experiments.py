"""Bugs of comparisons: running them, their statistics, and what is said of them."""

from tests.mutations.mutation import Mutation

MUTATIONS = [
    Mutation(
        "a flat run that was given up counts as if it had arrived",
        "experiments/price/ratios.py",
        "float(np.log(spent)) if has_arrived else np.inf",
        "float(np.log(spent))",
        "experiments/price/test_price.py",
    ),
    Mutation(
        "a ratio's ends take both costs from the same side",
        "experiments/price/ratios.py",
        "(paid[replicate][0] - others[replicate][1], paid[replicate][1] - others[replicate][0])",
        "(paid[replicate][0] - others[replicate][0], paid[replicate][1] - others[replicate][1])",
        "experiments/price/test_price.py",
    ),
    Mutation(
        "the interval of a median leaves out one number too many",
        "experiments/price/ratios.py",
        "outside = _count_outside(len(logs))",
        "outside = _count_outside(len(logs)) + 1",
        "experiments/price/test_price.py",
    ),
    Mutation(
        "one evaluation that is good enough ends a run",
        "agents/training/run.py",
        "return all(found.mean_return >= least for found in self.evaluations[-2:])",
        "return any(found.mean_return >= least for found in self.evaluations[-2:])",
        "agents/training/test_train.py",
    ),
    Mutation(
        "a score is measured from 0, not from the worst",
        "experiments/statistics.py",
        "return (np.asarray(returns, dtype=np.float64) - low) / (high - low)",
        "return np.asarray(returns, dtype=np.float64) / (high - low)",
        "experiments/test_statistics.py",
    ),
    Mutation(
        "an episode without escape has an efficiency",
        "experiments/statistics.py",
        "return np.where(np.asarray(escaped, dtype=bool), ratio, 0.0)",
        "return ratio",
        "experiments/test_statistics.py",
    ),
    Mutation(
        "an episode's efficiency exceeds 1",
        "experiments/statistics.py",
        "else np.minimum(found, 1.0).mean())",
        "else found.mean())",
        "experiments/test_statistics.py",
    ),
    Mutation(
        "a final value is the last evaluation's",
        "experiments/statistics.py",
        "[np.asarray(x, dtype=np.float64) >= LATE * end]))",
        "[np.asarray(x, dtype=np.float64) >= end]))",
        "experiments/test_statistics.py",
    ),
    Mutation(
        "rooms with more runs weigh more in a mean",
        "experiments/statistics.py",
        "return np.mean([room.mean(axis=-1) for room in scores], axis=0)",
        "return np.concatenate(scores, axis=-1).mean(axis=-1)",
        "experiments/test_statistics.py",
    ),
    Mutation(
        "an interval is one-sided",
        "experiments/inference.py",
        "return np.quantile(lower, (1 - level) / 2, axis=0)",
        "return np.quantile(lower, 1 - level, axis=0)",
        "experiments/test_inference.py",
    ),
    Mutation(
        "holm multiplies every p-value by the family's size",
        "experiments/inference.py",
        "min(1.0, (len(p) - rank) * p[index])",
        "min(1.0, len(p) * p[index])",
        "experiments/test_inference.py",
    ),
    Mutation(
        "holm lets a larger p-value fall below a smaller one's",
        "experiments/inference.py",
        "largest = max(largest, min(1.0,",
        "largest = max(0.0, min(1.0,",
        "experiments/test_inference.py",
    ),
    Mutation(
        "variances of rooms are biased",
        "experiments/inference.py",
        "room.var(ddof=1) / len(room) for room in rooms",
        "room.var(ddof=0) / len(room) for room in rooms",
        "experiments/test_inference.py",
    ),
    Mutation(
        "the title of a report is not escaped",
        "experiments/reporting/templates/report.html",
        "<title>{{ grid.name }}:",
        "<title>{{ grid.name | safe }}:",
        "experiments/reporting/test_report.py",
    ),
]
