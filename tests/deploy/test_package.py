"""The package as users install it: one name, whatever modules of their own are called."""

import os
import shutil
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest
import yaml

from clustermcl.runtime.version import VERSION

REPOSITORY = Path(__file__).parents[2]
PACKAGE = REPOSITORY / "clustermcl"
OWN_MODULES = ("worker.py", "protocol.py", "coordinator.py", "evaluation.py", "filter.py")
ENTRY_POINTS = ("localizer", "client", "commands.command", "worker.process", "coordinator.process")


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("built")
    for target in ("wheel", "sdist"):
        subprocess.run(
            [sys.executable, "-m", "hatchling", "build", "--target", target, "--directory", folder],
            cwd=REPOSITORY, check=True, capture_output=True,
        )  # fmt: skip
    return folder


def test_the_wheel_installs_one_name(built: Path) -> None:
    (wheel,) = built.glob("*.whl")
    names = zipfile.ZipFile(wheel).namelist()
    assert {name.split("/")[0] for name in names if ".dist-info/" not in name} == {"clustermcl"}
    packed = {name for name in names if name.startswith("clustermcl/")}
    tracked = {str(path.relative_to(REPOSITORY)) for path in PACKAGE.rglob("*.py")}
    assert tracked <= packed
    assert "clustermcl/view/static/index.html" in packed


def test_the_source_distribution_has_each_file_once(built: Path) -> None:
    (archive,) = built.glob("*.tar.gz")
    with tarfile.open(archive) as packed:
        files = [member for member in packed.getmembers() if member.isfile()]
    tails = [member.name.split("/", 1)[1] for member in files]
    assert "clustermcl/worker/worker.py" in tails
    assert not [tail for tail in tails if tail.startswith(("worker/", "coordinator/", "protocol/"))]


DEMO = """
import sys
sys.modules["numba"] = None  # as if it were not installed
sys.argv[1:] = ["evaluate", "sim:cross", "--steps", "12", "--jobs", "1"]
from clustermcl.commands.command import main
main()
"""


@pytest.mark.skipif(not shutil.which(os.environ.get("CC", "cc")), reason="there is no C compiler")
@pytest.mark.parametrize("library", ["best", "plain", "none"])
def test_the_wheel_localizes_without_numba(built: Path, library: str, tmp_path: Path) -> None:
    """The plain library is for any processor; without one, the error says what to install."""
    (wheel,) = built.glob("*.whl")
    folder = tmp_path / "installed"
    zipfile.ZipFile(wheel).extractall(folder)
    for file in (folder / "clustermcl/filter/kernels").glob("*.so"):
        if library == "none" or (library == "plain" and "-v3" in file.name):
            file.unlink()
    environment = {**os.environ, "PYTHONPATH": str(folder), "NUMBA_CACHE_DIR": str(tmp_path)}
    run = subprocess.run(
        [sys.executable, "-c", DEMO],
        cwd=tmp_path, env=environment, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert run.returncode == (2 if library == "none" else 0), run.stderr
    assert ("pip install 'clustermcl[compile]'" in run.stderr) == (library == "none")
    assert ("sim:cross" in run.stdout) == (library != "none")


@pytest.mark.parametrize("module", ENTRY_POINTS)
def test_modules_import_beside_a_users_modules_of_the_same_names(
    module: str, tmp_path: Path
) -> None:
    for name in OWN_MODULES:
        (tmp_path / name).write_text("raise ImportError('a user's module, not ours')\n")
    (tmp_path / "recordings").mkdir()
    (tmp_path / "recordings" / "__init__.py").write_text("raise ImportError('a folder of data')\n")
    command = [sys.executable, "-c", f"import clustermcl.{module}"]
    subprocess.run(command, cwd=tmp_path, check=True)


def test_citation_and_changelog_have_the_version() -> None:
    assert yaml.safe_load((REPOSITORY / "CITATION.cff").read_text())["version"] == VERSION
    assert f"## {VERSION} (" in (REPOSITORY / "CHANGELOG.md").read_text()
