import json
import re
import signal
from pathlib import Path
from typing import Any

from clustermcl.evaluation.references import load_reference
from clustermcl.simulator.worlds.catalogue import world
from tests.integration.system.commands import SMALL_FILTER, ran, typed
from tests.integration.waiting import PATIENCE_S, wait_until
from tests.maps import write_map

ROBOT = ["evaluate", "sim:cross_feature", *SMALL_FILTER]


def test_a_run_depends_on_its_seed_and_not_on_the_number_of_parallel_runs(
    environment: dict[str, str],
) -> None:
    def results(*more: str) -> dict[str, Any]:
        words = [*ROBOT, "--steps", "20", "--seeds", "3", "--set", "seed=7", "--json", *more]
        done = ran(*words, environment=environment, timeout_s=2 * PATIENCE_S)
        assert (done.returncode, done.stderr) == (0, "")
        answer: dict[str, Any] = json.loads(done.stdout)
        for run in answer["runs"]:
            assert min(run.pop("wall_s"), run.pop("cpu_s")) > 0.0
        return answer

    found = results()
    assert found["recording"] == "sim:cross_feature"
    assert [run["seed"] for run in found["runs"]] == [7, 8, 9]
    assert all(run["steps"] == 20 for run in found["runs"])
    assert results("--jobs", "1") == found


def test_a_killed_evaluation_leaves_no_process(tmp_path: Path, environment: dict[str, str]) -> None:
    words = [*ROBOT, "--steps", "100000", "--seeds", "4", "--jobs", "2"]
    with typed(*words, folder=tmp_path, environment=environment) as evaluation:
        wait_until(lambda: len(evaluation.meet_family()) >= 3)  # 2 and a tracker
        assert evaluation.end(signal.SIGKILL) == -signal.SIGKILL
        evaluation.assert_nothing_runs()


def test_an_interrupted_evaluation_keeps_the_finished_runs(
    tmp_path: Path, environment: dict[str, str]
) -> None:
    file = tmp_path / "runs.csv"
    words = ["-v", *ROBOT, "--steps", "5", "--seeds", "9999", "--output", str(file)]
    with typed(*words, folder=tmp_path, environment=environment) as evaluation:
        wait_until(lambda: "3 of 9999 runs are finished" in evaluation.err)
        assert evaluation.end(signal.SIGINT) == 130
        found = re.search(r"interrupted: (\d+) of 9999 runs are finished", evaluation.err)
        assert found
        assert f" of {found[1]}\n" in evaluation.out
        evaluation.assert_nothing_runs()
    assert len(file.read_text().splitlines()) == 1 + int(found[1]) >= 4


def test_a_robot_in_another_map_is_announced_and_its_estimates_are_written_for_evo(
    tmp_path: Path, environment: dict[str, str]
) -> None:
    other, file = write_map(world("cross").map, tmp_path, "cross"), tmp_path / "estimate.tum"
    words = ["evaluate", "sim:office", *SMALL_FILTER, "--steps", "12", "--map", str(other)]
    words += ["--tum", str(file)]
    with typed(*words, folder=tmp_path, environment=environment) as evaluation:
        assert evaluation.wait(2 * PATIENCE_S) == 0, evaluation.err
        assert f"drives in office, and is given the map {other}" in evaluation.err
        assert "sim:office: localized in 0 of 1" in evaluation.out, "and no emoji"
        assert "…" not in evaluation.out, "80 columns are enough"
    lines = file.read_text().splitlines()
    first_s, last_s = (float(line.split()[0]) for line in (lines[0], lines[-1]))
    poses = [load_reference(file).pose_at(round(at * 1e9)) for at in (first_s, last_s)]
    assert len(lines) == 12
    assert all(pose is not None and max(map(abs, pose[:2])) < 20.0 for pose in poses)
