import gzip
import logging
from functools import partial
from itertools import count
from pathlib import Path

import pytest
from msgspec.structs import replace

from clustermcl.commands.record_landmarks import run_record_landmarks
from clustermcl.link.wire import Publisher
from clustermcl.protocol import keys
from clustermcl.recordings.maps.landmarks import load_landmarks
from clustermcl.runtime.settings import Settings, ZenohSettings
from tests.integration.conftest import OpenClient
from tests.integration.running import running
from tests.integration.waiting import wait_until
from tests.unit.clustermcl.test_record_landmarks import odometry, seen
from tests.unit.view.messages import belief


def test_seen_landmarks_are_added_to_the_file(
    router: ZenohSettings, open_client: OpenClient, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO)
    file = tmp_path / "landmarks.yaml.gz"
    file.write_bytes(gzip.compress(b"landmarks: [{class: pillar, x: 1.0, y: 2.0}]"))
    settings = replace(Settings(), zenoh=router)
    session = open_client()
    belief_to, odometry_to, observation_to = (
        Publisher(session, key) for key in (keys.BELIEF, keys.ODOMETRY, keys.OBSERVATION_READING)
    )
    steps = count()

    def is_seen_enough() -> bool:
        step = next(steps)
        belief_to.put(replace(belief(step, 1), state="localized"))
        for name in ("door", "pillar"):
            observation_to.put(seen(step, (1.0, 0.0), name))
        session.put(keys.OBSERVATION_READING, b"\xc1")
        odometry_to.put(odometry(step, 0.0))
        return "landmark door was seen" in caplog.text

    with running(partial(run_record_landmarks, settings, file)):
        wait_until(is_seen_enough)
    pillar, door = load_landmarks(file)
    assert gzip.decompress(file.read_bytes()).startswith(b"landmarks:"), "packed as before"
    assert (pillar.name, door.name) == ("pillar", "door")
    assert (door.x, door.y) == pytest.approx((1.0 + 0.8776, 2.0 + 0.4794), abs=0.001)
    assert "not a valid Observation" in caplog.text
