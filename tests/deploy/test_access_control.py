import inspect
from pathlib import Path

import pytest
import zenoh

from clustermcl.link import secure_router
from clustermcl.link.access_control import ROLES, access_control, rights_of
from clustermcl.link.configuration import as_zenoh
from clustermcl.protocol import keys
from clustermcl.protocol.errors import SettingsError

DEPLOYED = Path(__file__).resolve().parents[2] / "deploy" / "router-secure.json5"
READ_BY_OTHERS = {"publishes": "reads", "serves": "asks", "announces": "watches"}


def all_keys() -> list[str]:
    """Every key, a worker's with a name of one; selectors without parameters."""
    of_names = ("LONGEST_NAME", "ROOM_FOR_NUMBER", "NAME_PATTERN")
    found = [key for name, key in vars(keys).items() if name.isupper() and name not in of_names]
    of_workers = [value for value in vars(keys).values() if inspect.isbuiltin(value)]
    assert len(of_workers) == 6
    return [*found, *(key("worker-0") for key in of_workers)]


def granted(right: str) -> list[str]:
    return [key for role in ROLES for key in getattr(rights_of(role, "worker-0"), right)]


@pytest.mark.parametrize("key", all_keys())
def test_every_key_is_written_by_one_role_and_read_by_another(key: str) -> None:
    ways = [
        right
        for right, other in READ_BY_OTHERS.items()
        if any(zenoh.KeyExpr(key).intersects(zenoh.KeyExpr(mine)) for mine in granted(right))
        and any(zenoh.KeyExpr(theirs).includes(zenoh.KeyExpr(key)) for theirs in granted(other))
    ]
    assert ways, f"{key}: give some role a right to it in clustermcl/link/access_control.py"


def test_the_rules_of_a_robot_name_that_robot_and_no_other() -> None:
    control = access_control(["r-1", "r-2"], ["worker"])
    for rule in control["rules"]:
        name = rule["id"].split()[0]
        robots = {key.split("/")[0] for key in rule["key_exprs"]}
        robot = name.partition(".")[2]
        assert robots == ({robot} if robot else {"r-1", "r-2"})
    plain = {s["id"] for s in control["subjects"] if "." not in s["id"]}
    assert plain == {"viewer", "operator"}


@pytest.mark.parametrize(
    ("robots", "workers", "problem_text"),
    [
        ([], ["worker", "worker-a"], "'worker' would cover the processes of 'worker-a'"),
        ([], ["worker-a", "worker-a-b"], "'worker-a' would cover the processes of 'worker-a-b'"),
        ([], ["hangar"], "--worker hangar: call it worker or worker-NAME"),
        (["r/1"], ["worker"], "'r/1' is not a valid name"),
        (["*"], ["worker"], "is not a valid name"),
    ],
)
def test_names_that_would_open_too_much_are_refused(
    robots: list[str], workers: list[str], problem_text: str
) -> None:
    with pytest.raises(SettingsError) as caught:
        access_control(robots, workers)
    assert problem_text in str(caught.value)


def test_the_deployed_file_is_what_the_program_writes(capsys: pytest.CaptureFixture[str]) -> None:
    assert secure_router.main([]) == 0
    assert capsys.readouterr().out == DEPLOYED.read_text()


def test_zenoh_parses_the_written_file_as_intended(tmp_path: Path) -> None:
    meant = secure_router.secure_router_configuration(
        secure_router.DEFAULT_ENDPOINT, secure_router.DEFAULT_CERTIFICATES, ["r-1"], ["worker-a"]
    )
    file = tmp_path / "router.json5"
    file.write_text(secure_router.as_commented_json5(meant, []))
    assert str(zenoh.Config.from_file(str(file))) == str(as_zenoh(meant))


def test_a_plain_endpoint_with_certificates_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert secure_router.main(["--listen", "tcp/0.0.0.0:7447"]) == 2
    assert "certificates need an endpoint tls/HOST:PORT" in capsys.readouterr().err
