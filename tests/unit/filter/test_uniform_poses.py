import numpy as np
import pytest
from scipy.stats import chi2

from clustermcl.filter.arrays import FREE, OCCUPIED, UNKNOWN, Cells, Pose, Poses
from clustermcl.filter.grid import Grid
from clustermcl.filter.poses import between
from clustermcl.filter.search import uniform_poses
from clustermcl.filter.search.uniform_poses import UniformPoses

ORIGIN = np.zeros(3)


def drawn(cells: Cells, count: int, map_from_grid: Pose = ORIGIN) -> Poses:
    poses = UniformPoses(Grid(cells, 0.5, map_from_grid), np.random.default_rng(0))
    return poses.draw(count, np.random.default_rng(1))


def cells_of(poses: Poses) -> tuple[np.ndarray, np.ndarray]:
    return (poses[:, 1] / 0.5).astype(int), (poses[:, 0] / 0.5).astype(int)


def room() -> Cells:
    cells = np.full((12, 15), UNKNOWN, np.int8)
    cells[2:10, 2:13] = OCCUPIED
    cells[3:9, 3:12] = FREE
    cells[5, 5:9] = OCCUPIED
    return cells


def test_poses_are_spread_evenly_over_the_free_cells() -> None:
    """Strata: each of the 50 cells gets its 80 of 4,000 poses give or take two strata's edges."""
    counts = np.zeros(room().shape, int)
    np.add.at(counts, cells_of(drawn(room(), 4000)), 1)
    assert counts[room() != FREE].sum() == 0
    free = counts[room() == FREE]
    assert len(free) == 50
    assert np.all(np.abs(free - 80) <= 2)


def test_poses_are_uniform_within_cells_and_headings() -> None:
    poses = drawn(room(), 8000)
    inside = np.mod(poses[:, :2] / 0.5, 1.0)
    for values in (inside[:, 0], inside[:, 1], (poses[:, 2] + np.pi) / (2.0 * np.pi)):
        counts, _ = np.histogram(values, bins=20, range=(0.0, 1.0))
        assert counts.sum() == 8000
        chi_squared = float(((counts - 400.0) ** 2 / 400.0).sum())
        assert chi_squared < chi2.ppf(1.0 - 1e-4, 19)  # a false alarm in ten thousand seeds


def test_uniform_poses_are_in_the_map_frame() -> None:
    shifted = np.array([3.0, -2.0, 0.7])
    rows, cols = cells_of(between(shifted, drawn(room(), 500, shifted)))
    assert np.all(room()[rows, cols] == FREE)


def test_of_a_large_map_some_cells_are_kept_that_cover_it_as_evenly(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Free space in three far apart parts of one that is mostly unknown; more of it than kept."""
    monkeypatch.setattr(uniform_poses, "_CELLS_KEPT", 500)
    cells = np.full((200, 90), UNKNOWN, np.int8)
    cells[3:13, :60] = FREE  # 600 cells
    cells[100:140, 10:40] = FREE  # 1,200
    cells[199, :] = FREE  # 90, in the last row
    poses = drawn(cells, 1890)
    rows, cols = cells_of(poses)
    assert np.all(cells[rows, cols] == FREE)
    parts = [np.count_nonzero(rows < 50), np.count_nonzero((rows > 50) & (rows < 150))]
    # 500 kept cells of 1,890 stand for 3.8 each; two at each edge.
    assert parts[0] == pytest.approx(600, abs=8)
    assert parts[1] == pytest.approx(1200, abs=8)
    assert np.count_nonzero(rows == 199) == pytest.approx(90, abs=8)
    counts, _ = np.histogram(rows[(rows >= 100) & (rows < 140)], bins=8, range=(100, 140))
    assert np.all(np.abs(counts - 150) <= 8), "evenly within a part, too"


def test_one_free_cell_is_enough_and_none_is_refused() -> None:
    cells = np.full((1500, 3), UNKNOWN, np.int8)
    with pytest.raises(ValueError, match="no free cell"):
        drawn(cells, 10)
    cells[1400, 1] = FREE
    rows, cols = cells_of(drawn(cells, 10))
    assert (set(rows), set(cols)) == ({1400}, {1})
