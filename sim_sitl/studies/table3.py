"""The paper's Table III: all four classifiers on data made anew, beside the paper's figures.

Why: the paper's claim rests on this table. Rules kept here: every classifier is given the
same captures of the same links and the same split; the split is by geometry, and what a
split by row, features as they come, or the paper's 3 MHz do to the figures is shown beside it, not in
it; what a clock says is kept out of the results' CSV.
"""

from __future__ import annotations

import importlib.util
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from groundstation.channel import load_classifier
from groundstation.channel.training.classical import (
    LinkClassifier,
    captures_of,
    gaussian_process,
    random_forest,
    support_vectors,
)
from groundstation.channel.training.data import LinkData, read_links, single_captures, split_by_group
from groundstation.channel.training.metrics import Confusion, Figures, confusion, figures
from groundstation.channel.training.network import NetworkClassifier, ShippedClassifier
from groundstation.domain.errors import ResourceError, UsageError
from sim_sitl.dataset import DatasetOptions, dataset_sounder, write_dataset

if TYPE_CHECKING:
    from sim_sitl.studies.commands import ProgressReport, StudyOptions

ROWS_MIN = 200
SPLITS = 3
TEST_SHARE = 0.2
CAUTIOUS = 0.75
"""Operating threshold where a NLOS link called LOS costs three times the opposite."""
EPOCHS = 40
CAPTURE, LINK = "capture", "link"


@dataclass(frozen=True, slots=True)
class PaperRow:
    """As printed in Table III."""

    accuracy: float
    precision: float
    auc: float
    time_ms: float


PAPER: dict[str, PaperRow] = {
    "RF": PaperRow(0.9519, 0.9448, 0.9499, 0.0184),
    "GPC": PaperRow(0.7124, 0.6920, 0.7091, 6.7676),
    "SVM": PaperRow(0.7001, 0.6566, 0.6933, 0.6435),
    "CNN–LSTM": PaperRow(0.9290, 0.9108, 0.9696, 0.2544),
}
PAPER_ROWS = 41_000


@dataclass(frozen=True, slots=True)
class Entry:
    """One classifier in one section."""

    name: str
    """Row's name; a prefix of the paper's name is set beside the paper's figures."""
    build: Callable[[int], LinkClassifier]
    """Seed → an untrained classifier."""


@dataclass(frozen=True, slots=True)
class Section:
    """One data set, one way to split it, some classifiers."""

    key: str
    title: str
    note: str
    bandwidth_mhz: float
    tap_spacing_ns: float
    equal_noise: bool
    """Whether noise is drawn alike for both labels instead of by the link budget."""
    split: str
    """``geometry`` or ``row``."""
    splits: int
    """How many random splits."""
    entries: tuple[Entry, ...]
    instances: tuple[str, ...]
    """What is classified: single captures, links of several, or both."""
    paper: bool
    """Whether the paper's figures may stand beside."""


@dataclass(frozen=True, slots=True, eq=False)
class Outcome:
    """One classifier on one split's test part."""

    section: str
    name: str
    instance: str
    split: int
    figures: Figures
    """At P ≥ 0.5."""
    cautious: Figures
    """At P ≥ CAUTIOUS."""
    counts: Confusion
    """At P ≥ 0.5."""
    probability: NDArray[np.float64]
    is_los: NDArray[np.bool_]
    fit_s: float
    """CPU seconds of training."""
    predict_ms: float
    """CPU milliseconds to classify one instance, in batches, features or inputs given."""


@dataclass(frozen=True, slots=True, eq=False)
class Table3:
    """All that was found."""

    rows: int
    seed: int
    command: str
    sections: tuple[Section, ...]
    outcomes: tuple[Outcome, ...]
    left_out: dict[str, int]
    """Captures that no input could be made of, over all data sets."""
    wall_s: float

    def of(self, section: str, name: str, instance: str) -> list[Outcome]:
        """One row's outcomes, a split each."""
        return [
            outcome
            for outcome in self.outcomes
            if (outcome.section, outcome.name, outcome.instance) == (section, name, instance)
        ]


def sections(epochs: int, splits: int, network_done: Callable[[int, int], None]) -> tuple[Section, ...]:
    """What the study runs; ``network_done(epoch, epochs)`` is told of each epoch of a training."""

    def network(seed: int) -> LinkClassifier:
        return NetworkClassifier(
            seed, epochs, on_epoch=lambda epoch, training, validation: network_done(epoch, epochs)
        )

    forest, process, vectors = (
        Entry("RF", random_forest),
        Entry("GPC", gaussian_process),
        Entry("SVM", support_vectors),
    )
    fit_forest = Entry("RF, with goodness of fit", lambda seed: random_forest(seed, goodness_of_fit=True))
    raw = (
        Entry("GPC", lambda seed: gaussian_process(seed, scaled=False)),
        Entry("SVM", lambda seed: support_vectors(seed, scaled=False)),
    )
    shipped = Entry("shipped CNN–LSTM, as it is", lambda seed: ShippedClassifier(load_classifier()))
    learned = Entry("CNN–LSTM", network)
    wide, alike, paper_band = (500.0, 1.0016, False), (500.0, 1.0016, True), (3.0, 333.0, False)
    return (
        Section(
            "geometry",
            "Split by geometry, 500 MHz",
            "What holds for links that were never seen. 500 MHz and 1.0016 ns a tap resolve the model's "
            "paths; the paper says 3 MHz (below).",
            *wide, "geometry", splits, (forest, fit_forest, process, vectors, learned, shipped),
            (CAPTURE, LINK), True,
        ),
        Section(
            "row",
            "Split by row, 500 MHz",
            "Captures of one geometry in training and test, as when rows are shuffled and cut.",
            *wide, "row", 1, (forest, process, vectors), (CAPTURE,), False,
        ),
        Section(
            "unscaled",
            "Features as they come, 500 MHz",
            "Split by geometry, but the features not standardised: kurtosis in the hundreds drowns the rest "
            "in a kernel's distance. Forests do not mind.",
            *wide, "geometry", 1, (forest, *raw), (CAPTURE,), False,
        ),
        Section(
            "equal-noise",
            "The same noise for both labels, 500 MHz",
            "Split by geometry. In the paper's data obstructed links are weaker, so that how far a response "
            "stands above the noise tells much of the label; here it tells nothing, and shape is left.",
            *alike, "geometry", 1, (forest, fit_forest, process, vectors, learned, shipped),
            (CAPTURE,), False,
        ),
        Section(
            "3mhz",
            "The paper's bandwidth: 3 MHz, 333 ns a tap",
            "Split by geometry. Paths are not resolved: what is left is how far the response stands above "
            "the noise.",
            *paper_band, "geometry", 1, (forest, process, vectors, learned), (CAPTURE,), False,
        ),
        Section(
            "3mhz-unscaled",
            "3 MHz, 333 ns a tap, features as they come",
            "Split by geometry.",
            *paper_band, "geometry", 1, (forest, *raw), (CAPTURE,), False,
        ),
    )  # fmt: skip


def run(
    options: StudyOptions,
    progress: ProgressReport | None = None,
    *,
    epochs: int = EPOCHS,
    splits: int = SPLITS,
) -> list[Path]:
    """``sim-sitl study table3``: ``options.trials`` rows a data set. Returns the files, the report first.

    ``options.methods`` leaves only these rows' names. Raises UsageError or ResourceError before any work.
    """
    from sim_sitl.studies.commands import make_folder
    from sim_sitl.studies.table3_report import write_table3

    if options.trials < ROWS_MIN:
        raise UsageError(
            f"--trials {options.trials}; table3 counts rows: {ROWS_MIN} or more (the paper has 41,000)"
        )
    if options.scheduler is not None:
        raise UsageError("--scheduler does not go with table3: it trains on this machine")
    for module, extra in (("matplotlib", "study"), ("sklearn", "train"), ("torch", "train")):
        if importlib.util.find_spec(module) is None:
            raise ResourceError(f"table3 needs {module}: pip install 'groundstation[{extra}]'")
    steps = Steps(progress)
    chosen = [_only(section, options.methods) for section in sections(epochs, splits, steps.epoch)]
    chosen = [section for section in chosen if section.entries]
    if not chosen:
        raise UsageError(f"--methods: table3 has {', '.join(PAPER)}; asked for: {', '.join(options.methods)}")
    make_folder(options.out)
    return write_table3(compute(chosen, options, steps), options.out)


def compute(chosen: Sequence[Section], options: StudyOptions, steps: Steps) -> Table3:
    """Make the data sets and put every classifier to each."""
    began = time.monotonic()
    import torch

    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    kinds = list(dict.fromkeys(map(_kind, chosen)))
    entries = sum(section.splits * len(section.entries) for section in chosen)
    steps.expect(2 * options.trials * len(kinds), entries, options.trials // 4)
    outcomes: list[Outcome] = []
    left_out: dict[str, int] = {}
    try:
        for kind in kinds:
            data = make_data(options.trials, options.seed, *kind, steps.rows)
            for reason, count in data.left_out.items():
                left_out[reason] = left_out.get(reason, 0) + count
            for section in chosen:
                if _kind(section) == kind:
                    outcomes += _section_outcomes(section, data, options, steps)
    finally:
        torch.set_num_threads(threads)
    return Table3(
        options.trials, options.seed, options.command, tuple(chosen), tuple(outcomes), left_out,
        time.monotonic() - began,
    )  # fmt: skip


def _kind(section: Section) -> tuple[float, float, bool]:
    return section.bandwidth_mhz, section.tap_spacing_ns, section.equal_noise


def make_data(
    rows: int,
    seed: int,
    bandwidth_mhz: float,
    tap_spacing_ns: float,
    equal_noise: bool,
    on_rows: Callable[[int], None] = lambda rows: None,
) -> LinkData:
    """The plain data set with its statistics; ``on_rows`` counts rows written, then rows read."""
    options = DatasetOptions(dataset_sounder(bandwidth_mhz, tap_spacing_ns), equal_noise=equal_noise)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "channels.npz"
        write_dataset(rows, seed, path, Increments(on_rows), options)
        return read_links(path, Increments(on_rows), with_features=True, keep_noise=True)


def _section_outcomes(section: Section, data: LinkData, options: StudyOptions, steps: Steps) -> list[Outcome]:
    single = single_captures(data)
    source = data if section.split == "geometry" else single
    outcomes = []
    for split in range(section.splits):
        seed = options.seed + split
        training, rest, test = split_by_group(
            source, (1 - 1.5 * TEST_SHARE, 0.5 * TEST_SHARE, TEST_SHARE), seed
        )
        training = np.sort(np.concatenate([training, rest]))
        captures = captures_of(source, test)[0]
        for entry in section.entries:
            classifier = entry.build(seed)
            began = time.process_time()
            classifier.fit(source, training)
            fit_s = time.process_time() - began
            for instance in section.instances:
                tested, links = (single, captures) if instance == CAPTURE else (source, test)
                began = time.process_time()
                probability = classifier.predict_proba(tested, links)
                predict_ms = 1e3 * (time.process_time() - began) / len(links)
                is_los = tested.is_los[links]
                outcomes.append(
                    Outcome(
                        section.key, entry.name, instance, split, figures(probability, is_los),
                        figures(probability, is_los, CAUTIOUS), confusion(probability, is_los),
                        probability, is_los, fit_s, predict_ms,
                    )
                )  # fmt: skip
            steps.entry()
    return outcomes


def _only(section: Section, methods: tuple[str, ...]) -> Section:
    if not methods:
        return section
    return replace(section, entries=tuple(entry for entry in section.entries if entry.name in methods))


class Increments:
    """``progress(done, total)`` as increments."""

    def __init__(self, add: Callable[[int], None]) -> None:
        self._add, self._done = add, 0

    def __call__(self, done: int, total: int) -> None:
        self._add(done - self._done)
        self._done = done


class Steps:
    """How much of the study is done, in rows: a training counts as some."""

    def __init__(self, report: ProgressReport | None) -> None:
        self._report = report
        self._done = self._total = 0.0
        self._entry = self._within = 0.0

    def expect(self, rows: int, entries: int, rows_an_entry: int) -> None:
        """What is to come; training and testing one classifier counts as ``rows_an_entry``."""
        self._entry = float(rows_an_entry)
        self._total = rows + entries * self._entry
        self._tell()

    def rows(self, count: int) -> None:
        """Rows written or read."""
        self._done += count
        self._tell()

    def epoch(self, epoch: int, epochs: int) -> None:
        """Within a training."""
        self._within = self._entry * epoch / epochs
        self._tell()

    def entry(self) -> None:
        """A classifier is through."""
        self._done, self._within = self._done + self._entry, 0.0
        self._tell()

    def _tell(self) -> None:
        if self._report is not None and self._total:
            self._report(min(int(self._done + self._within), int(self._total)), int(self._total))
