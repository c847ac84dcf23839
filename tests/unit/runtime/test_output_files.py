import os
from pathlib import Path

import pytest

from clustermcl.runtime.output_files import OutputError, check_output_file


def test_a_file_that_can_be_written_is_not_touched(tmp_path: Path) -> None:
    there = tmp_path / "there.json"
    there.write_text("as it was")
    for file in (there, tmp_path / "new.json", Path(os.devnull)):
        check_output_file(file)
    assert list(tmp_path.iterdir()) == [there]
    assert there.read_text() == "as it was"


@pytest.mark.parametrize(
    ("name", "problem"),
    [
        ("missing/x.json", "its folder does not exist"),
        ("file/x.json", "its folder does not exist"),
        ("folder", "it is a folder"),
        ("/proc/x.json", ""),  # a folder of the kernel, which refuses new files even to root
    ],
)
def test_the_error_of_a_file_that_cannot_be_written_has_the_reason(
    tmp_path: Path, name: str, problem: str
) -> None:
    (tmp_path / "file").touch()
    (tmp_path / "folder").mkdir()
    with pytest.raises(OutputError, match=f"{name}: cannot be written: {problem}"):
        check_output_file(tmp_path / name)
