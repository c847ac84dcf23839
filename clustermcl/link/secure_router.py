"""The router's configuration for several machines: mutual TLS and access control.

``python -I -m clustermcl.link.secure_router --worker worker-a --worker worker-b > FILE`` writes a
file for `zenohd --config FILE` or `clustermcl.link.router --config FILE`. The file
``deploy/router-secure.json5`` is its output without arguments.
"""

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import PurePosixPath
from typing import Any

from clustermcl.link.access_control import WORKER, access_control
from clustermcl.link.configuration import (
    Configuration,
    check_endpoint,
    patient,
    router_configuration,
)
from clustermcl.protocol.errors import SettingsError
from clustermcl.runtime.main import outermost
from clustermcl.runtime.output_files import written_output
from clustermcl.runtime.settings import ZenohSettings

DEFAULT_ENDPOINT = "tls/0.0.0.0:7447"
DEFAULT_CERTIFICATES = "/etc/clustermcl/certificates"

_WIDTH = 100


def secure_router_configuration(
    endpoint: str, certificates: str, robots: Sequence[str], workers: Sequence[str]
) -> Configuration:
    """Return the configuration of a router that accepts only certificates of its authority.

    The folder `certificates` on the router's machine has ``authority.pem``, ``router.pem`` and
    ``router.key``; it is not opened here. Robots and workers are named as in `access_control`,
    which raises `SettingsError`, as an invalid endpoint does.
    """
    check_endpoint(endpoint)
    if not endpoint.startswith("tls/"):
        raise SettingsError(f"--listen {endpoint}: certificates need an endpoint tls/HOST:PORT")
    folder = PurePosixPath(certificates)
    configuration = router_configuration(ZenohSettings())
    configuration["listen"] = {"endpoints": [patient(endpoint)]}
    configuration["transport"]["link"] |= {
        "protocols": ["tls"],
        "tls": {
            "root_ca_certificate": str(folder / "authority.pem"),
            "listen_certificate": str(folder / "router.pem"),
            "listen_private_key": str(folder / "router.key"),
            "enable_mtls": True,
            "close_link_on_expiration": True,
        },
    }
    configuration["access_control"] = access_control(robots, workers)
    return configuration


def as_commented_json5(configuration: Configuration, arguments: Sequence[str]) -> str:
    """Return the file's text, with the command that wrote it as a comment."""
    command = " ".join(("python -I -m clustermcl.link.secure_router", *arguments))
    return (
        "// Mutual TLS and access control, deny by default. Written by\n"
        f"//   {command}\n"
        "// docs/security.md explains the roles. Do not edit: run the command again.\n"
        f"{_laid_out(configuration)}\n"
    )


def _laid_out(value: Any, indent: int = 0) -> str:
    """Return JSON with each value on one line where it fits."""
    line = json.dumps(value)
    if len(line) + indent < _WIDTH or not isinstance(value, dict | list):
        return line
    if isinstance(value, dict):
        parts = [f"{json.dumps(k)}: {_laid_out(v, indent + 2)}" for k, v in value.items()]
    else:
        parts = [_laid_out(item, indent + 2) for item in value]
    inner = ",\n".join(" " * (indent + 2) + part for part in parts)
    opening, closing = "{}" if isinstance(value, dict) else "[]"
    return f"{opening}\n{inner}\n{' ' * indent}{closing}"


def main(argv: Sequence[str] | None = None) -> int:
    words = list(sys.argv[1:] if argv is None else argv)
    about = "Write a router's configuration with mutual TLS and access control."
    parser = argparse.ArgumentParser("secure_router", description=about, allow_abbrev=False)
    add, default = parser.add_argument, "(default: %(default)s)"
    add("--listen", default=DEFAULT_ENDPOINT, metavar="ENDPOINT", help=default)
    files = f"of authority.pem, router.pem and router.key {default}"
    add("--certificates", default=DEFAULT_CERTIFICATES, metavar="FOLDER", help=files)
    robot = "certificates are valid for one robot each, as bridge.NAME; may be repeated"
    add("--robot", action="append", default=[], metavar="NAME", help=robot)
    worker = f"name of a worker certificate, {WORKER} or {WORKER}-NAME; may be repeated"
    add("--worker", action="append", default=[], metavar="NAME", help=worker)
    given = parser.parse_args(words)

    def write() -> None:
        configuration = secure_router_configuration(
            given.listen, given.certificates, given.robot, given.worker or [WORKER]
        )
        with written_output():
            sys.stdout.write(as_commented_json5(configuration, words))

    return outermost("secure_router", write)


if __name__ == "__main__":
    sys.exit(main())
