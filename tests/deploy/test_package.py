"""The package as users install it: one name, whatever modules of their own are called."""

import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest

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
