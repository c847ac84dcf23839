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


def test_of_a_covariance_the_largest_standard_deviation_is_used(tmp_path: Path) -> None:
    """0.3 m along (1, 1) and 0.1 m across."""
    entry = "{id: a, x: 1, y: 2, covariance: [0.05, 0.04, 0.04, 0.05], count: 17}"
    (found,) = load_landmarks(written(tmp_path, f"landmarks: [{entry}]"))
    assert found.sigma == pytest.approx(0.3)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("", "not a landmarks file"),
        ("landmarks: [{id: a, x: 1}]", "missing required field `y`"),
        ("landmarks: [{id: a, x: 1, y: .nan}]", "landmarks"),
        ("landmarks: [{id: a, x: 1, y: 2, z: 3}]", "unknown field `z`"),
        ("landmarks: [{id: a, x: 1, y: 2, sigma: 0}]", "sigma"),
        ("landmarks: [{id: a, x: 1, y: 2, covariance: [1, 2, 2, 1]}]", "positive definite"),
        ("landmarks: [{id: a, x: 1, y: 2, covariance: [1, 0, 0.1, 1]}]", "positive definite"),
        ("landmarks: [{id: a, x: 1, y: 2, covariance: [.inf, 0, 0, 1]}]", "covariance"),
        ("landmarks: [{id: a, x: 1, y: 2, covariance: [1, 0, 0]}]", "covariance"),
        (
            "landmarks: [{id: a, x: 1, y: 2, sigma: 1, covariance: [1, 0, 0, 1]}]",
            "needs a sigma, or a positive definite covariance",
        ),
        ("landmarks: [{x: 1, y: 2}]", "needs either an id or a class"),
        ("landmarks: [{id: a, class: b, x: 1, y: 2}]", "needs either an id or a class"),
        ("landmarks: [{id: a, x: 1, y: 2}, {id: a, x: 3, y: 2}]", "the id 'a' is used before"),
        ("landmarks: [{id: a, x: 1, y: 2}, {class: a, x: 3, y: 2}]", "the id 'a' is used before"),
        ("landmarks: [{class: a, x: 1, y: 2}, {id: a, x: 3, y: 2}]", "the id 'a' is used before"),
        ("landmarks: [&a {id: a, x: 1, y: 2}, *a]", "aliases"),
        ("landmarks: [" + "{class: a, x: 1, y: 2}, " * 501 + "]", "length <= 500"),
        ("landmarks: [", "not YAML"),
    ],
)
def test_a_wrong_file_is_refused_with_its_reason(tmp_path: Path, content: str, words: str) -> None:
    with pytest.raises(LandmarksFileError, match=words):
        load_landmarks(written(tmp_path, content))
