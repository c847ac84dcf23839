from collections.abc import Iterator
from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from clustermcl import ClusterMCL, Reading, RecordingError, SettingsError, read_recording, register
from clustermcl.filter.laser.sensor_model import SensorModel
from clustermcl.runtime import extensions
from clustermcl.simulator.simulation import Simulation
from clustermcl.simulator.worlds.catalogue import world


@pytest.fixture(autouse=True)
def forgotten(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[None]:
    extensions.extensions.clear()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    extensions._installed.cache_clear()
    yield
    extensions._installed.cache_clear()


class Counting(SensorModel):
    asked = 0

    def log_likelihood(self, *of: object) -> np.ndarray:
        type(self).asked += 1
        return super().log_likelihood(*of)  # type: ignore[arg-type] # handed on


def test_own_models_weigh_and_move_the_particles_of_searches_and_places() -> None:
    hall, moved = world("hall"), []

    def still(poses: np.ndarray, motion: np.ndarray, _settings: object, noise: np.ndarray):  # type: ignore[no-untyped-def] # as a user writes it
        moved.append((poses.shape, motion.shape, noise.shape))
        return poses.copy()

    register("sensor_model", "counting", Counting)
    register("motion_model", "still", still)
    own = {"sensor.model": "counting", "motion.model": "still", "cluster.particles": 200}
    mcl = ClusterMCL(hall.map, settings=own)
    weighed = [
        Counting.asked
        for tick in islice(Simulation(hall, 0), 20)
        for message in (tick.odometry[0], tick.laser)
        if mcl.update(Reading.of(message))
    ]
    assert 0 < weighed[0] < weighed[1] < weighed[-1]
    poses, motion, noise = moved[-1]
    assert (poses[1], motion, noise) == (3, (3,), (3, poses[0]))


def test_an_installed_model_is_found_by_its_entry_point(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "own_model.py").write_text(
        "from clustermcl.filter.laser.sensor_model import SensorModel\n"
        "class Own(SensorModel):\n    pass\n"
    )
    about = tmp_path / "own_model-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: own_model\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text(
        "[clustermcl.sensor_model]\nown = own_model:Own\ngone = own_model:Gone\n"
    )
    with pytest.raises(SettingsError, match='"likelihood_field" or an installed one'):
        ClusterMCL(world("hall").map, settings={"sensor.model": "own"})
    extensions._installed.cache_clear()
    monkeypatch.syspath_prepend(str(tmp_path))
    mcl = ClusterMCL(world("hall").map, settings={"sensor.model": "own"})
    assert type(mcl._model).__name__ == "Own"
    assert not list((tmp_path / "clustermcl" / "maps").glob("field-*")), "its arrays are not kept"
    with pytest.raises(ValueError, match=r"sensor_model 'gone' cannot be loaded: .*Gone"):
        extensions.extensions["sensor_model", "gone"]


@pytest.mark.parametrize("wrong", ["os:system", "os.system", "../model.py", "", "a" * 10_000])
def test_only_installed_extensions_are_loaded(wrong: str) -> None:
    for kind in ("sensor", "motion"):
        with pytest.raises(SettingsError, match="an installed one"):
            ClusterMCL(world("hall").map, settings={f"{kind}.model": wrong})


def test_a_users_reader_is_tried_first_and_its_errors_name_the_file(tmp_path: Path) -> None:
    file = tmp_path / "run.own"

    def reader(path: Path) -> Iterator[Reading] | None:
        return lines(path) if path.suffix == ".own" else None

    def lines(path: Path) -> Iterator[Reading]:
        for line in path.read_text().split():
            yield Reading((float(line), 0.0, 0.0), [1.0, 2.0], angle_step=0.1, range_max=9.0)

    register("recording_reader", "own", reader)
    file.write_text("0 0.5 1.0")
    assert [reading.odom_from_robot[0] for reading in read_recording(file)] == [0.0, 0.5, 1.0]  # type: ignore[index] # given
    file.write_text("0 x")
    with pytest.raises(RecordingError, match=r"run\.own: reader 'own': could not convert"):
        read_recording(file)
    file.write_text("")
    with pytest.raises(RecordingError, match="no scan in it"):
        read_recording(file)
    with pytest.raises(RecordingError, match="no such file"):
        read_recording(tmp_path / "other.log")
