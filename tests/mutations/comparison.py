"""Bugs of comparisons: running them, their statistics, and what is said of them."""

from tests.mutations.mutation import Mutation

MUTATIONS = [
    Mutation(
        "equal differences are certain, however few they are",
        "comparison/inference.py",
        "math.prod(4.0 ** (1 - len(room)) for room in lasting)",
        "0.0",
        "comparison/test_inference.py",
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
        "comparison/statistics.py",
        "return (np.asarray(returns, dtype=np.float64) - low) / (high - low)",
        "return np.asarray(returns, dtype=np.float64) / (high - low)",
        "comparison/test_statistics.py",
    ),
    Mutation(
        "an episode without escape has an efficiency",
        "comparison/statistics.py",
        "return np.where(np.asarray(escaped, dtype=bool), ratio, 0.0)",
        "return ratio",
        "comparison/test_statistics.py",
    ),
    Mutation(
        "an episode's efficiency exceeds 1",
        "comparison/statistics.py",
        "else np.minimum(found, 1.0).mean())",
        "else found.mean())",
        "comparison/test_statistics.py",
    ),
    Mutation(
        "a final value is the last evaluation's",
        "comparison/statistics.py",
        "[np.asarray(x, dtype=np.float64) >= LATE * end]))",
        "[np.asarray(x, dtype=np.float64) >= end]))",
        "comparison/test_statistics.py",
    ),
    Mutation(
        "rooms with more runs weigh more in a mean",
        "comparison/statistics.py",
        "return np.mean([room.mean(axis=-1) for room in scores], axis=0)",
        "return np.concatenate(scores, axis=-1).mean(axis=-1)",
        "comparison/test_statistics.py",
    ),
    Mutation(
        "an interval is one-sided",
        "comparison/inference.py",
        "return np.quantile(lower, (1 - level) / 2, axis=0)",
        "return np.quantile(lower, 1 - level, axis=0)",
        "comparison/test_inference.py",
    ),
    Mutation(
        "holm multiplies every p-value by the family's size",
        "comparison/inference.py",
        "min(1.0, (len(p) - rank) * p[index])",
        "min(1.0, len(p) * p[index])",
        "comparison/test_inference.py",
    ),
    Mutation(
        "holm lets a larger p-value fall below a smaller one's",
        "comparison/inference.py",
        "largest = max(largest, min(1.0,",
        "largest = max(0.0, min(1.0,",
        "comparison/test_inference.py",
    ),
    Mutation(
        "variances of rooms are biased",
        "comparison/inference.py",
        "room.var(ddof=1) / len(room) for room in rooms",
        "room.var(ddof=0) / len(room) for room in rooms",
        "comparison/test_inference.py",
    ),
    Mutation(
        "the title of a report is not escaped",
        "comparison/reporting/templates/report.html",
        "<title>{{ grid.name }}:",
        "<title>{{ grid.name | safe }}:",
        "comparison/reporting/test_report.py",
    ),
]
