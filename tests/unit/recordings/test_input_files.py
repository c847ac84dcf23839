"""What holds for maps, references, landmarks and recordings alike."""

import gzip
import lzma
from collections.abc import Callable
from pathlib import Path

import pytest

from clustermcl import LandmarksFileError, load_landmarks
from clustermcl.evaluation.references import load_reference
from clustermcl.protocol.errors import (
    InputFileError,
    MapFileError,
    RecordingError,
    ReferenceFileError,
)
from clustermcl.recordings.maps.map_file import load_map
from clustermcl.recordings.recording import Recording, open_recording
from clustermcl.runtime import compressed
from clustermcl.runtime.settings import BridgeSettings

Load = Callable[[Path], object]


def opened(path: Path) -> Recording:
    return open_recording(path, BridgeSettings())


every_kind = pytest.mark.parametrize(
    ("load", "refusal"),
    [
        (load_map, MapFileError),
        (load_reference, ReferenceFileError),
        (load_landmarks, LandmarksFileError),
        (opened, RecordingError),
    ],
)


@every_kind
def test_a_missing_file_and_a_folder_are_refused(
    tmp_path: Path, load: Load, refusal: type[InputFileError]
) -> None:
    with pytest.raises(refusal, match=r"nowhere\.yaml: no such file"):
        load(tmp_path / "nowhere.yaml")
    with pytest.raises(refusal, match="is a folder"):
        load(tmp_path)


@every_kind
def test_a_file_whose_packed_content_is_cut_off_is_refused(
    tmp_path: Path, load: Load, refusal: type[InputFileError]
) -> None:
    path = tmp_path / "cut.yaml"
    path.write_bytes(gzip.compress(b"# a remark\n" * 100)[:-20])
    with pytest.raises(refusal, match="cut off"):
        load(path)


@every_kind
@pytest.mark.parametrize("pack", [bytes, gzip.compress, lzma.compress])
def test_a_file_that_unpacks_without_end_is_refused(
    tmp_path: Path,
    load: Load,
    refusal: type[InputFileError],
    pack: Callable[[bytes], bytes],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """After 8 MiB here, so that the test is short; the code is the same for all limits."""
    monkeypatch.setattr(compressed, "MAX_FILE_BYTES", 2**23)
    path = tmp_path / "bomb.yaml"
    path.write_bytes(pack(b"# nothing at all in this remark\n" * 600_000))
    with pytest.raises(refusal, match=r"MiB unpacked|a few hundred"):
        load(path)
