"""Diagnoses certificates: what is wrong with the files, and why a router refuses them.

Zenoh only reports that it cannot connect; Python's TLS, given the same files, reports the reason.
"""

import re
import socket
import ssl
import stat
from _ssl import _test_decode_cert  # type: ignore[attr-defined] # the only parser in Python
from contextlib import suppress
from pathlib import Path

from clustermcl.protocol.errors import SettingsError
from clustermcl.runtime.compressed import os_problem
from clustermcl.runtime.settings import ZenohSettings

_PROBE_S = 1.0
_ALERT_S = 0.3

_UNKNOWN_AUTHORITY = "it is not signed by the router's authority"

_REFUSALS = {
    "TLSV1_ALERT_UNKNOWN_CA": _UNKNOWN_AUTHORITY,
    "TLSV1_ALERT_DECRYPT_ERROR": _UNKNOWN_AUTHORITY,
    "TLSV13_ALERT_CERTIFICATE_REQUIRED": "the router requires a certificate: set "
    "zenoh.tls_certificate and zenoh.tls_private_key",
    "SSLV3_ALERT_CERTIFICATE_EXPIRED": "it has expired, or is not valid yet by the clock",
    "SSLV3_ALERT_UNSUPPORTED_CERTIFICATE": "it is not a client's certificate",
    "SSLV3_ALERT_BAD_CERTIFICATE": "the router cannot read it",
}
"""The problem of the client's certificate, by OpenSSL's name of the router's TLS alert."""


def check_files(settings: ZenohSettings) -> None:
    """Reject certificate files that cannot be read, are not PEM, or do not match."""
    for name in ("tls_ca_certificate", "tls_certificate", "tls_private_key"):
        file = getattr(settings, name)
        if not file:
            continue
        given = f"zenoh.{name} = {file!r}"
        kind = "private key" if name == "tls_private_key" else "certificate"
        try:
            text = Path(file).read_text(encoding="ascii", errors="replace")
            mode = Path(file).stat().st_mode
        except OSError as error:
            raise SettingsError(f"{given}: {os_problem(error)}") from error
        if not re.search(rf"-----BEGIN [A-Z ]*{kind.upper()}-----", text):
            raise SettingsError(f"{given}: there is no {kind} in it (PEM)")
        if kind == "private key" and mode & stat.S_IRWXO:
            raise SettingsError(f"{given}: others may read or write it; run chmod o= on it")
    certificate, key = settings.tls_certificate, settings.tls_private_key
    if bool(certificate) != bool(key):
        given, missing = ("tls_certificate", "tls_private_key")[:: 1 if certificate else -1]
        raise SettingsError(f"zenoh.{missing} is not set, but zenoh.{given} is: give both")
    _context(settings)


def why_refused(settings: ZenohSettings) -> str | None:
    """Repeat Zenoh's TLS handshake with these checked files, and return why it fails.

    None: the certificates are valid, or no server listens there.
    """
    try:
        host, port = _address(settings.router)
        with (
            socket.create_connection((host, port), _PROBE_S) as raw,
            _context(settings).wrap_socket(raw, server_hostname=host) as connection,
        ):
            connection.settimeout(_ALERT_S)  # in TLS 1.3 the refusal follows the handshake
            connection.recv(1)
    except ssl.SSLCertVerificationError as error:
        return f"the router's certificate is not trusted: {error.verify_message}"
    except ssl.SSLError as error:
        meaning = _REFUSALS.get(error.reason or "", f"TLS fails with {error.reason}")
        given = f"zenoh.tls_certificate = {settings.tls_certificate!r}"
        refused = given if settings.tls_certificate else "a client without a certificate"
        return f"the router refuses {refused}: {meaning}"
    except (OSError, ValueError):
        return None
    return None


def requires_tls(endpoint: str) -> bool:
    """Return whether a server at an endpoint ``tcp/HOST:PORT`` speaks TLS."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    try:
        host, port = _address(endpoint)
        with (
            socket.create_connection((host, port), _PROBE_S) as raw,
            context.wrap_socket(raw) as connection,
        ):
            return connection.version() is not None
    except (OSError, ValueError):  # an SSLError is an OSError: it speaks no TLS
        return False


def common_name(certificate: str) -> str:
    """Return the common name of a certificate file; empty if it has none."""
    with suppress(OSError, ValueError):
        for part in _test_decode_cert(certificate).get("subject", ()):
            for key, value in part:
                if key == "commonName":
                    return str(value)
    return ""


def _address(endpoint: str) -> tuple[str, int]:
    """Return host and port of an endpoint ``PROTOCOL/HOST:PORT``; a ValueError: it has no port."""
    host, _, port = endpoint.partition("/")[2].rpartition(":")
    return host.strip("[]"), int(re.sub(r"[?#].*", "", port))


def _context(settings: ZenohSettings) -> ssl.SSLContext:
    authority = settings.tls_ca_certificate
    try:
        context = ssl.create_default_context(cafile=authority or None)
    except ssl.SSLError as error:
        problem = f"zenoh.tls_ca_certificate = {authority!r}: not a certificate: {error.reason}"
        raise SettingsError(problem) from error
    certificate, key = settings.tls_certificate, settings.tls_private_key
    if certificate:
        try:
            context.load_cert_chain(certificate, key, password="")  # never asks at the terminal
        except ssl.SSLError as error:
            is_other = error.reason == "KEY_VALUES_MISMATCH"
            why = "the key belongs to another certificate" if is_other else error.reason
            given = f"zenoh.tls_private_key = {key!r} and zenoh.tls_certificate = {certificate!r}"
            raise SettingsError(f"{given} do not match: {why or 'not readable'}") from error
    return context
