"""What an experiment came to, as a file: one JSON object with every run and every figure."""

import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import msgspec

from evaluation.experiments.case import Algorithm, Case
from evaluation.experiments.figures import Figure, Reading, read
from evaluation.experiments.measures import RunMeasures
from evaluation.experiments.provenance import Provenance
from evaluation.experiments.reliability import Reliability, pooled
from process_runtime.output_files import OutputError


class RunRecord(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One run that was begun and not interrupted."""

    algorithm: Algorithm
    seed: int
    problem: str | None = None
    """Why it failed; None: it did not."""
    measures: RunMeasures | None = None
    reliability: Reliability = msgspec.field(default_factory=Reliability)
    """Of the estimates: probability claimed, and whether right."""
    places_reliability: Reliability = msgspec.field(default_factory=Reliability)
    """The same of all places held."""


class ExperimentResult(msgspec.Struct, kw_only=True):
    """An experiment and its runs so far."""

    case: Case
    provenance: Provenance
    runs: list[RunRecord] = msgspec.field(default_factory=list)

    @property
    def complete(self) -> bool:
        """Whether all runs that were planned have ended."""
        return len(self.runs) >= self.case.seeds * len(self.case.algorithms)

    def of(self, algorithm: Algorithm) -> list[RunRecord]:
        """The runs of one algorithm, by seed."""
        runs = [run for run in self.runs if run.algorithm == algorithm]
        return sorted(runs, key=lambda run: run.seed)

    def measures(self, algorithm: Algorithm) -> list[RunMeasures | None]:
        """Of each run of an algorithm; None of one that failed."""
        return [run.measures for run in self.of(algorithm)]

    def by_seed(self, algorithm: Algorithm) -> dict[int, RunMeasures | None]:
        """Each run of an algorithm by its seed; None of one that failed."""
        return {run.seed: run.measures for run in self.of(algorithm)}

    def readings(self, algorithm: Algorithm) -> list[tuple[Figure, Reading]]:
        """All figures of an algorithm."""
        measures = self.measures(algorithm)
        return [(figure, read(figure, measures)) for figure in self.case.figures]

    def reliability(self, algorithm: Algorithm, *, of_places: bool = False) -> Reliability:
        """All claims of an algorithm: of its estimates, or of all places it held."""
        runs = self.of(algorithm)
        return pooled(run.places_reliability if of_places else run.reliability for run in runs)


def write_result(result: ExperimentResult, folder: Path) -> Path:
    """Write `NAME.json` into a folder; it appears complete or not at all.

    Raises:
        OutputError: the file cannot be written.
    """
    text = msgspec.json.format(msgspec.json.encode(_as_object(result)), indent=1)
    return write_text(folder / f"{result.case.name}.json", text.decode() + "\n")


def write_text(path: Path, text: str) -> Path:
    """Write a file at once, with the folders above it.

    Raises:
        OutputError: it cannot be written.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(
            "w", dir=path.parent, delete=False, encoding="utf-8"
        ) as file:
            file.write(text)
        Path(file.name).chmod(0o644)
        Path(file.name).replace(path)
    except OSError as error:
        raise OutputError(path=path, problem=error.strerror or str(error)) from error
    return path


def _as_object(result: ExperimentResult) -> dict[str, Any]:
    case = result.case
    return {
        "experiment": case.name,
        "title": case.title,
        "role": case.role,
        "complete": result.complete,
        "seeds": {
            algorithm: [run.seed for run in result.of(algorithm)] for algorithm in case.algorithms
        },
        "asked_seeds": case.asked_seeds or case.seeds,
        "provenance": result.provenance,
        "figures": {algorithm: _figures(result, algorithm) for algorithm in case.algorithms},
        "runs": [run for algorithm in case.algorithms for run in result.of(algorithm)],
    }


def _figures(result: ExperimentResult, algorithm: Algorithm) -> Sequence[dict[str, Any]]:
    return [
        {"figure": figure, "target": figure.target, "reading": reading}
        for figure, reading in result.readings(algorithm)
    ]
