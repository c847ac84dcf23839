import os
import tempfile
from pathlib import Path

import pytest

from clustermcl.filter.kernels import folders
from clustermcl.filter.kernels.folders import remarks, user_folder, why_untrusted

STRANGER = 54321


@pytest.fixture(autouse=True)
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.delenv("XDG_STATE_HOME", raising=False)
    remarks.clear()
    return tmp_path


def test_folders_follow_the_rule_of_xdg(home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert user_folder("maps") == home / ".cache/clustermcl/maps"
    assert user_folder("state") == home / ".local/state/clustermcl"
    monkeypatch.setenv("XDG_CACHE_HOME", str(home / "cache"))
    assert user_folder("kernels") == home / "cache/clustermcl/kernels"
    assert not remarks


def test_a_relative_folder_is_not_used(home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(home)
    monkeypatch.setenv("XDG_CACHE_HOME", "here")
    assert user_folder("maps") == home / ".cache/clustermcl/maps"
    assert list(remarks) == [
        "here/clustermcl/maps of XDG_CACHE_HOME is not used: it is not absolute"
    ]


def test_an_account_whose_home_cannot_be_written_has_a_folder_among_the_temporary_files(
    home: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(home))
    monkeypatch.setattr(os, "access", lambda path, mode: mode == os.F_OK and Path(path).exists())
    folders._temporary_folder.cache_clear()
    own = home / f"clustermcl-{os.geteuid()}"
    assert user_folder("maps") == own / "maps"
    assert own.stat().st_mode & 0o777 == 0o700
    first, second = remarks
    assert first.endswith("of the account's home is not used: it cannot be written")
    assert second.startswith(f"maps: kept in {own}/maps until the machine restarts")
    folders._temporary_folder.cache_clear()
    assert user_folder("maps") == own / "maps", "also if it is there"
    folders._temporary_folder.cache_clear()
    own.chmod(0o777)
    assert user_folder("maps").parent not in (own, home), "others may have written there"
    folders._temporary_folder.cache_clear()


@pytest.mark.skipif(os.geteuid() != 0, reason="only root gives files to other accounts")
@pytest.mark.parametrize(
    ("uid", "gid", "mode", "is_trusted"),
    [
        (0, 0, 0o644, True),
        (0, 0, 0o664, True),  # a private group, as many accounts have
        (0, 4, 0o664, False),
        (0, 4, 0o646, False),
        (0, 4, 0o644, True),
        (STRANGER, STRANGER, 0o600, False),
    ],
)
def test_what_others_may_write_is_not_trusted(
    tmp_path: Path, uid: int, gid: int, mode: int, *, is_trusted: bool
) -> None:
    file = tmp_path / "file"
    assert not why_untrusted(file), "a missing file"
    file.touch()
    os.chown(file, uid, gid)
    file.chmod(mode)
    assert bool(why_untrusted(file)) is not is_trusted
