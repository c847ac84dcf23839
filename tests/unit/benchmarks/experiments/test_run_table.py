from pathlib import Path

import numpy as np
import pytest

from benchmarks.experiments.measures import BINS
from benchmarks.experiments.run_table import RunTable, key_of, rows_of
from benchmarks.experiments.task import Finished, Task
from clustermcl.filter.settings import BeliefSettings
from clustermcl.protocol.errors import InputFileError
from clustermcl.runtime.settings import Settings
from tests.unit.benchmarks.experiments.made_up import case, measures


def finished(**measured: object) -> Finished:
    counts = np.arange(3.0 * BINS).reshape(3, BINS)
    return Finished(measures=measures(**measured), calibration=counts)


def task(seed: int = 0, settings: Settings | None = None) -> Task:
    return Task(case=case(), algorithm="mcl", seed=seed, settings=settings or Settings())


def test_a_row_holds_the_run_and_its_measures(tmp_path: Path) -> None:
    file = tmp_path / "new" / "runs.csv"
    settings = Settings(seed=7, belief=BeliefSettings(max_clusters=9))
    RunTable(file).append(task(seed=3, settings=settings), finished(localized=True, rmse_m=None))
    (row,) = rows_of(file)
    assert (row["experiment"], row["algorithm"], row["seed"]) == ("made-up", "mcl", "3")
    assert (row["localized"], row["rmse_m"]) == ("True", "")
    assert row["settings"] == "belief.max_clusters=9"
    assert [row["claims_0"], row["right_0"], row["claimed_9"]] == ["0.0", "10.0", "29.0"]


def test_a_table_of_runs_is_continued_and_lists_its_runs(tmp_path: Path) -> None:
    file = tmp_path / "runs.csv"
    RunTable(file).append(task(0), finished())
    again = RunTable(file)
    assert again.done == {key_of(task(0))}
    again.append(task(1), finished())
    assert len(rows_of(file)) == 2
    assert RunTable(file).done == {key_of(task(0)), key_of(task(1))}


@pytest.mark.parametrize("text", ["", "a,b\n1,2\n"])
def test_a_file_that_is_no_table_of_runs_is_refused(tmp_path: Path, text: str) -> None:
    file = tmp_path / "other.csv"
    file.write_text(text)
    with pytest.raises(InputFileError, match="no table of this version's runs"):
        rows_of(file)
    if text:
        with pytest.raises(InputFileError):
            RunTable(file)
        assert file.read_text() == text
