from pathlib import Path

import pytest

from clustermcl import LandmarksFileError, load_landmarks
from clustermcl.protocol.steps import Landmark

GOOD = """
landmarks:
  - {id: tag 3, x: 1.5, y: -2}
  - {class: reflector, x: 0, y: 0, sigma: 0.01}
  - {class: reflector, x: 4, y: 0, sigma: 0.01}
"""


def written(folder: Path, content: str | bytes) -> Path:
    path = folder / "landmarks.yaml"
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


def test_landmarks_of_a_class_share_their_name(tmp_path: Path) -> None:
    assert load_landmarks(written(tmp_path, GOOD)) == (
        Landmark(name="tag 3", x=1.5, y=-2.0, sigma=0.05),
        Landmark(name="reflector", x=0.0, y=0.0, sigma=0.01),
        Landmark(name="reflector", x=4.0, y=0.0, sigma=0.01),
    )


@pytest.mark.parametrize(("content", "words"), [
    ("", "not a landmarks file"),
    ("landmarks: [{id: a, x: 1}]", "missing required field `y`"),
    ("landmarks: [{id: a, x: 1, y: .nan}]", "landmarks"),
    ("landmarks: [{id: a, x: 1, y: 2, z: 3}]", "unknown field `z`"),
    ("landmarks: [{id: a, x: 1, y: 2, sigma: 0}]", "sigma"),
    ("landmarks: [{x: 1, y: 2}]", "needs either an id or a class"),
    ("landmarks: [{id: a, class: b, x: 1, y: 2}]", "needs either an id or a class"),
    ("landmarks: [{id: a, x: 1, y: 2}, {id: a, x: 3, y: 2}]", "the id 'a' is used before"),
    ("landmarks: [{id: a, x: 1, y: 2}, {class: a, x: 3, y: 2}]", "the id 'a' is used before"),
    ("landmarks: [{class: a, x: 1, y: 2}, {id: a, x: 3, y: 2}]", "the id 'a' is used before"),
    ("landmarks: [&a {id: a, x: 1, y: 2}, *a]", "aliases"),
    ("landmarks: [" + "{class: a, x: 1, y: 2}, " * 501 + "]", "length <= 500"),
    ("landmarks: [", "not YAML"),
])  # fmt: skip
def test_a_wrong_file_is_refused_with_its_reason(tmp_path: Path, content: str, words: str) -> None:
    with pytest.raises(LandmarksFileError, match=words):
        load_landmarks(written(tmp_path, content))
