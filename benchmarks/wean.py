"""Recordings of CMU's Wean Hall, as logs of CARMEN.

    O x y theta ts                            odometry
    L x y theta xl yl thetal r1 .. r180 ts    pose of the robot, of the laser, 180 ranges

Centimetres, radians, seconds. Beams run counter-clockwise from -90 degrees, one per degree, to
+89. The poses of an `L` line are the odometry at the time of the scan.

    python -m benchmarks.wean LOG CARMEN_LOG
"""

import math
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from clustermcl.evaluation.run import RecordedRobot
from clustermcl.recordings.log_file import words_of_lines
from clustermcl.recordings.recording import Recording, open_recording
from clustermcl.runtime.settings import BridgeSettings


class WeanRobot(RecordedRobot, frozen=True, kw_only=True):
    """A recording of Wean Hall."""

    def opened(self, settings: BridgeSettings) -> Recording:
        with tempfile.TemporaryDirectory() as folder:
            return open_recording(as_carmen(self.recording, Path(folder) / "log"), settings)


def as_carmen(log: Path, written: Path) -> Path:
    """Write a log of Wean Hall as one of CARMEN."""
    lines = (_line(words) for _, words in words_of_lines(log, []))
    written.write_text("\n".join(lines) + "\n")
    return written


def _line(words: Sequence[str]) -> str:
    when = f"{words[-1]} wean {words[-1]}"
    if words[0] == "O":
        return f"ODOM {_pose(words[1:4])} 0 0 0 {when}"
    ranges = " ".join(map(_metres, words[7:-1]))
    config = f"0 {-math.pi / 2!r} {math.pi!r} {math.radians(1.0)!r} 0 0 0"
    poses = f"{_pose(words[4:7])} {_pose(words[1:4])}"
    return f"ROBOTLASER1 {config} {len(words) - 8} {ranges} 0 {poses} 0 0 0 0 0 {when}"


def _pose(words: Sequence[str]) -> str:
    return f"{_metres(words[0])} {_metres(words[1])} {words[2]}"


def _metres(centimetres: str) -> str:
    return repr(float(centimetres) * 0.01)


if __name__ == "__main__":
    as_carmen(Path(sys.argv[1]), Path(sys.argv[2]))
