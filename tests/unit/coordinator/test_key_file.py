from pathlib import Path

import pytest

from coordinator.key_file import read_key
from protocol.errors import SettingsError


def test_no_file_is_no_key() -> None:
    assert read_key("") is None


def test_a_line_is_a_key(tmp_path: Path) -> None:
    file = tmp_path / "key"
    file.write_text("0123456789abcdef" * 4 + "\n")
    file.chmod(0o440)  # of a group, as Kubernetes has it
    assert read_key(str(file)) == b"0123456789abcdef" * 4


@pytest.mark.parametrize("content", [b"", b"\n" * 64, b"short", b"x" * 5_000])
def test_what_is_no_key_is_refused_with_the_setting(tmp_path: Path, content: bytes) -> None:
    file = tmp_path / "key"
    file.write_bytes(content)
    file.chmod(0o600)
    with pytest.raises(SettingsError, match=r"coordinator.key_file = .*32 to 4096 bytes"):
        read_key(str(file))


def test_a_file_that_is_not_there_is_said_in_one_line(tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match=r"coordinator.key_file = .*No such file"):
        read_key(str(tmp_path / "nothing"))


@pytest.mark.parametrize("mode", [0o644, 0o604, 0o602])
def test_a_file_that_others_may_read_or_write_is_refused(tmp_path: Path, mode: int) -> None:
    file = tmp_path / "key"
    file.write_text("0123456789abcdef" * 4)
    file.chmod(mode)
    with pytest.raises(SettingsError, match=r"key_file = .*others may read or write it"):
        read_key(str(file))
