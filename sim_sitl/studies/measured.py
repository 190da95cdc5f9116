"""A file of measured responses: what few logs teach, judged on logs never seen, beside trees.

Why: whether a classifier carries over to another place is the question, and two dozen logs answer it
only with an interval. Rules kept here: whole logs are held out; every method gets the same
folds, and folds are dealt many times, for which logs fall together moves an area by more than
most methods differ; intervals and differences by resampling logs; nothing is tuned on the file.
"""

from __future__ import annotations

import importlib.util
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from groundstation.channel.calibration import Calibration
from groundstation.channel.classifier import WEIGHTS_DIR, load_classifier
from groundstation.channel.training.classical import FeatureClassifier, random_forest
from groundstation.channel.training.data import LinkData, read_links
from groundstation.domain.errors import InputError, ResourceError, UsageError

if TYPE_CHECKING:
    from sim_sitl.studies.commands import ProgressReport, StudyOptions

FOLDS = 6
SHARES = (0.25, 0.5, 0.75, 1.0)
"""Of the training logs, for the learning curve."""
RESAMPLES = 2000
TRAINED, STATISTICS, PULSE, SHIPPED = (
    "groundstation train", "direct-path statistics", "first-pulse share alone", "shipped CNN–LSTM as it is",
)  # fmt: skip
TREES = ("RF on six features", "GB on six features", "RF on twelve features", "GB on twelve features")
"""Random forest and gradient boosting on the paper's features; and with the distances to its fits and the
four statistics of the direct path."""
METHODS = (TRAINED, STATISTICS, PULSE, SHIPPED, *TREES)

Judge = Callable[[NDArray[np.int64], NDArray[np.int64], int], NDArray[np.float64]]
"""(training links, held-out links, seed) → P(line of sight) of the latter."""


@dataclass(frozen=True, slots=True)
class Interval:
    """A figure with its 95 % interval, by bootstrap over logs."""

    value: float
    low: float
    high: float


@dataclass(frozen=True, slots=True)
class Score:
    """One method, the mean over all deals of the folds."""

    method: str
    auc: Interval
    balanced: Interval
    auc_gain: Interval
    """Less the best tree's AUC, on the same links."""
    balanced_gain: Interval
    """Less the best tree's balanced accuracy."""
    auc_deals: tuple[float, float]
    """Least and most over the deals."""
    balanced_deals: tuple[float, float]
    auc_folds: float
    """Mean of the folds' own AUCs (those that hold both classes)."""
    balanced_folds: float


@dataclass(frozen=True, slots=True)
class CurvePoint:
    """One method with a share of the training logs."""

    method: str
    logs: float
    """Trained on, the mean over folds."""
    auc: Interval
    balanced: Interval


@dataclass(frozen=True, slots=True)
class Measured:
    """All that was found."""

    name: str
    """The file's."""
    captures: int
    logs: int
    los_logs: int
    deals: int
    command: str
    scores: tuple[Score, ...]
    best_auc: str
    """The tree with the highest AUC."""
    best_balanced: str
    """The tree with the highest balanced accuracy."""
    curve: tuple[CurvePoint, ...]
    network_taken: float
    """Share of the trainings that took the network's logit in."""


def run(options: StudyOptions, progress: ProgressReport | None = None) -> list[Path]:
    """``sim-sitl study measured --data FILE``: ``options.trials`` deals. Returns the files, the report first.

    Raises UsageError, ResourceError or InputError (a file that will not do) before any training.
    """
    from sim_sitl.studies.commands import make_folder
    from sim_sitl.studies.measured_report import write_measured

    if options.data is None:
        raise UsageError("measured needs --data FILE: responses with label and log_id (docs/channel-data.md)")
    if options.scheduler is not None:
        raise UsageError("--scheduler does not go with measured: it runs on this machine")
    for method in options.methods:
        if method not in METHODS:
            raise UsageError(f"--methods: measured has no {method!r}; it has: {', '.join(METHODS)}")
    for module, extra in (("matplotlib", "study"), ("sklearn", "train"), ("torch", "train")):
        if importlib.util.find_spec(module) is None:
            raise ResourceError(f"measured needs {module}: pip install 'groundstation[{extra}]'")
    data = read_links(options.data, with_features=True)
    check(data, options.data)
    make_folder(options.out)
    return write_measured(compute(data, options, progress), options.out)


def check(data: LinkData, path: Path) -> None:
    """Raises InputError where logs cannot be held out."""
    if not data.grouped:
        raise InputError(f"{path} does not tell its logs: log_id is needed to hold whole logs out")
    los, nlos = (len(np.unique(data.group[data.is_los == state])) for state in (True, False))
    if min(los, nlos) < 3:
        raise InputError(f"{path} has {los} LOS and {nlos} NLOS logs; 3 of each are needed to hold some out")


def compute(data: LinkData, options: StudyOptions, progress: ProgressReport | None = None) -> Measured:
    """Every method over every deal, then the learning curve."""
    import torch

    from groundstation.channel.training.measured import deal_groups
    from groundstation.channel.training.measured_recipe import some_groups

    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        judges, taken = _judges(data, options.methods)
        curved = [name for name in judges if name not in (SHIPPED, PULSE)]
        curve_deals = max(1, options.trials // 3)
        total = options.trials * len(judges) + curve_deals * len(SHARES[:-1]) * len(curved)
        done = 0

        def cross_fit(name: str, deal: int, share: float = 1.0) -> tuple[NDArray[np.float64], float]:
            nonlocal done
            fold = deal_groups(data.group, data.is_los, FOLDS, options.seed + deal)
            probability, logs = np.zeros(len(data)), []
            for number in np.unique(fold):
                seen = some_groups(data, np.flatnonzero(fold != number), share, options.seed + deal)
                held_out = np.flatnonzero(fold == number)
                probability[held_out] = judges[name](seen, held_out, options.seed + deal)
                logs.append(len(np.unique(data.group[seen])))
            done += 1
            if progress is not None:
                progress(done, total)
            return probability, float(np.mean(logs))

        whole = {
            name: np.stack([cross_fit(name, deal)[0] for deal in range(options.trials)]) for name in judges
        }
        counts = resampled_logs(len(np.unique(data.group)), options.seed)
        draws = {name: Draws.of(data, probability, counts) for name, probability in whole.items()}
        trees = [name for name in TREES if name in draws] or list(draws)
        best_auc = max(trees, key=lambda name: draws[name].auc[0])
        best_balanced = max(trees, key=lambda name: draws[name].balanced[0])
        folds = [
            deal_groups(data.group, data.is_los, FOLDS, options.seed + deal) for deal in range(options.trials)
        ]
        scores = tuple(
            _score(data, name, whole[name], folds, draws[name], draws[best_auc], draws[best_balanced])
            for name in judges
        )
        network_taken = float(np.mean(taken)) if taken else math.nan
        all_logs = len(np.unique(data.group)) * (1 - 1 / FOLDS)
        curve = []
        for name in curved:
            for share in SHARES[:-1]:
                parts = [cross_fit(name, deal, share) for deal in range(curve_deals)]
                found = Draws.of(data, np.stack([part[0] for part in parts]), counts)
                logs = float(np.mean([part[1] for part in parts]))
                curve.append(CurvePoint(name, logs, found.interval("auc"), found.interval("balanced")))
            found = draws[name]
            curve.append(CurvePoint(name, all_logs, found.interval("auc"), found.interval("balanced")))
    finally:
        torch.set_num_threads(threads)
    assert options.data is not None
    los_logs = len(np.unique(data.group[data.is_los]))
    return Measured(
        options.data.name, len(data.inputs), len(np.unique(data.group)), los_logs, options.trials,
        options.command, scores, best_auc, best_balanced, tuple(curve), network_taken,
    )  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class Draws:
    """A method's figures, the mean over deals: [0] of the logs as they are, then of each resample."""

    auc: NDArray[np.float64]
    balanced: NDArray[np.float64]

    @classmethod
    def of(cls, data: LinkData, probability: NDArray[np.float64], counts: NDArray[np.float64]) -> Draws:
        """Of (deals, links) probabilities; ``counts`` (draws, logs) says how often each log was drawn.

        The area under a ROC curve is a sum over pairs of logs (Mann–Whitney), so that a resample
        weighs pairs instead of sorting links anew. Resamples without both classes are NaN.
        """
        logs, index = np.unique(data.group, return_inverse=True)
        los = np.bincount(index[data.is_los], minlength=len(logs)).astype(np.float64)
        nlos = np.bincount(index[~data.is_los], minlength=len(logs)).astype(np.float64)
        with np.errstate(invalid="ignore"):
            areas, balances = [], []
            for row in probability:
                wins = _wins(row, data.is_los, index, len(logs))
                pairs = np.einsum("di,ij,dj->d", counts, wins, counts)
                areas.append(pairs / ((counts @ los) * (counts @ nlos)))
                called = row >= 0.5
                hits = np.bincount(index[data.is_los & called], minlength=len(logs))
                passed = np.bincount(index[~data.is_los & ~called], minlength=len(logs))
                balances.append(0.5 * (counts @ hits / (counts @ los) + counts @ passed / (counts @ nlos)))
        return cls(np.mean(areas, axis=0), np.mean(balances, axis=0))

    def interval(self, figure: str, reference: Draws | None = None) -> Interval:
        """Of ``auc`` or ``balanced``; less that of ``reference``, resample by resample."""
        values: NDArray[np.float64] = getattr(self, figure)
        if reference is not None:
            values = values - getattr(reference, figure)
        low, high = np.nanquantile(values[1:], [0.025, 0.975])
        return Interval(float(values[0]), float(low), float(high))


def resampled_logs(logs: int, seed: int) -> NDArray[np.float64]:
    """(1 + RESAMPLES, logs) how often each log is drawn; the first row is the logs as they are."""
    rng = np.random.default_rng([seed, 41])
    drawn = rng.multinomial(logs, np.full(logs, 1 / logs), size=RESAMPLES)
    return np.concatenate([np.ones((1, logs)), drawn]).astype(np.float64)


def _wins(
    score: NDArray[np.float64], is_los: NDArray[np.bool_], log: NDArray[np.int64], logs: int
) -> NDArray[np.float64]:
    """(logs, logs) pairs of a LOS link of one and a NLOS link of the other that are in order; ties half."""
    result = np.zeros((logs, logs))
    for number in np.unique(log[~is_los]):
        against = np.sort(score[~is_los & (log == number)])
        below = np.searchsorted(against, score[is_los], "left")
        not_above = np.searchsorted(against, score[is_los], "right")
        result[:, number] = np.bincount(log[is_los], weights=0.5 * (below + not_above), minlength=logs)
    return result


def _score(
    data: LinkData,
    name: str,
    probability: NDArray[np.float64],
    folds: list[NDArray[np.int64]],
    found: Draws,
    best_auc: Draws,
    best_balanced: Draws,
) -> Score:
    from groundstation.channel.training.metrics import figures

    deals = [figures(row, data.is_los) for row in probability]
    parts = [
        figures(row[fold == number], data.is_los[fold == number])
        for row, fold in zip(probability, folds, strict=True)
        for number in np.unique(fold)
        if 0 < np.count_nonzero(data.is_los[fold == number]) < np.count_nonzero(fold == number)
    ]
    areas, balanced = [one.auc for one in deals], [one.balanced_accuracy for one in deals]
    return Score(
        name, found.interval("auc"), found.interval("balanced"), found.interval("auc", best_auc),
        found.interval("balanced", best_balanced), (min(areas), max(areas)), (min(balanced), max(balanced)),
        float(np.mean([one.auc for one in parts])) if parts else math.nan,
        float(np.mean([one.balanced_accuracy for one in parts])) if parts else math.nan,
    )  # fmt: skip


def _judges(data: LinkData, only: tuple[str, ...]) -> tuple[dict[str, Judge], list[bool]]:
    """The methods by name, and a list that gets, a training each, whether it took the network in."""
    from groundstation.channel.training.export import load_weights
    from groundstation.channel.training.measured import STATISTICS as NAMES
    from groundstation.channel.training.measured import choose_head, fit_head, inputs_of
    from groundstation.channel.training.model import CnnLstm

    network = CnnLstm()
    network.load_state_dict(load_weights(WEIGHTS_DIR))
    network.eval()
    inputs = inputs_of(data, network)
    metadata = load_classifier().metadata
    shipped = Calibration(metadata.temperature, metadata.bias).probability(inputs[:, -1])
    taken: list[bool] = []

    def trained(seen: NDArray[np.int64], held_out: NDArray[np.int64], seed: int) -> NDArray[np.float64]:
        head = choose_head(inputs[seen], data.is_los[seen], data.group[seen], seed)
        taken.append(len(head.weight) > len(NAMES))
        return Calibration().probability(head.logit(inputs[held_out]))

    def weighed(columns: int) -> Judge:
        def judge(seen: NDArray[np.int64], held_out: NDArray[np.int64], seed: int) -> NDArray[np.float64]:
            head = fit_head(inputs[seen, :columns], data.is_los[seen], data.group[seen])
            return Calibration().probability(head.logit(inputs[held_out]))

        return judge

    def tree(build: Callable[[int], FeatureClassifier], given: LinkData) -> Judge:
        def judge(seen: NDArray[np.int64], held_out: NDArray[np.int64], seed: int) -> NDArray[np.float64]:
            classifier = build(seed)
            classifier.fit(given, seen)
            return classifier.predict_proba(given, held_out)

        return judge

    assert data.features is not None
    link_of = np.repeat(np.arange(len(data)), data.packets)
    rows = np.repeat(data.first - np.cumsum(data.packets) + data.packets, data.packets) + np.arange(
        len(link_of)
    )
    statistics = np.empty((len(data.inputs), len(NAMES)))
    statistics[rows] = inputs[link_of, : len(NAMES)]
    twelve = replace(data, features=np.column_stack([data.features, statistics]))
    judges: dict[str, Judge] = {
        TRAINED: trained,
        STATISTICS: weighed(len(NAMES)),
        PULSE: weighed(1),
        SHIPPED: lambda seen, held_out, seed: shipped[held_out],
        TREES[0]: tree(random_forest, data),
        TREES[1]: tree(_boosting, data),
        TREES[2]: tree(lambda seed: random_forest(seed, goodness_of_fit=True), twelve),
        TREES[3]: tree(lambda seed: _boosting(seed, goodness_of_fit=True), twelve),
    }
    return {name: judge for name, judge in judges.items() if not only or name in only}, taken


def _boosting(seed: int, *, goodness_of_fit: bool = False) -> FeatureClassifier:
    def build(seed: int) -> Any:
        from sklearn.ensemble import HistGradientBoostingClassifier

        return HistGradientBoostingClassifier(max_iter=100, random_state=seed)

    return FeatureClassifier("GB", build, seed, goodness_of_fit)
