import re
import signal
from pathlib import Path

from clustermcl.link.session import open_session
from clustermcl.link.wire import is_alive
from clustermcl.protocol import keys
from clustermcl.runtime.settings import RobotSettings, ZenohSettings
from clustermcl.runtime.stop import StopFlag
from clustermcl.runtime.supervisor import python_module
from tests.integration.conftest import StartProcess
from tests.integration.waiting import PATIENCE_S, wait_until

TLS = '[zenoh]\nrouter = "tls/localhost:7447"\n'
BAD = {
    "broken": ("[zenoh\n", "not TOML"),
    "unknown": ("[worker]\nnumber = 3\n", "unknown setting worker.number"),
    "no-authority": (f'{TLS}tls_ca_certificate = "none.pem"\n', "no such file"),
    "open-key": (
        f'{TLS}tls_certificate = "%(folder)s/a.pem"\ntls_private_key = "%(folder)s/a.key"\n',
        "others may read",
    ),
    "second": ('[robot]\nname = "robot"\n[zenoh]\nrouter = "%(router)s"\n', "are both of robot"),
}


def test_a_bad_file_is_skipped_and_used_once_it_is_mended(
    router: ZenohSettings, start_process: StartProcess, tmp_path: Path
) -> None:
    fleet = tmp_path / "fleet"
    fleet.mkdir()
    (tmp_path / "a.pem").write_text("-----BEGIN CERTIFICATE-----")
    (tmp_path / "a.key").write_text("-----BEGIN PRIVATE KEY-----")
    (tmp_path / "a.key").chmod(0o644)
    for name, (text, _problem) in BAD.items():
        filled = text % {"folder": tmp_path, "router": router.router}
        (fleet / f"{name}.toml").write_text(filled)
    good = f'[zenoh]\nrouter = "{router.router}"\n[robot]\nname = "%s"\n'
    (fleet / "a.toml").write_text(good % "robot")
    pool = start_process(
        python_module("clustermcl.worker", "--name", "pool", "--fleet", str(fleet), "--count", "2")
    )

    def is_served(robot: str) -> None:
        with open_session(router, RobotSettings(name=robot), StopFlag(), PATIENCE_S) as session:
            wait_until(lambda: is_alive(session, keys.worker_alive("pool-1"), 1.0))

    is_served("robot")
    for name in BAD:  # in one step, as half a file would be one more problem
        (tmp_path / name).write_text(good % f"late-{name}")
        (tmp_path / name).replace(fleet / f"{name}.toml")
    for name in BAD:
        is_served(f"late-{name}")
    for name, (_text, problem) in BAD.items():
        (line,) = (line for line in pool.err.splitlines() if f"{name}.toml is " in line)
        assert re.search(problem, line)
    pool.send_signal(signal.SIGTERM)
    assert pool.wait() == 0
