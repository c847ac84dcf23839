"""A Debian of its own, made by debootstrap and booted with systemd by systemd-nspawn."""

import os
import shlex
import shutil
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import psutil

ROOT = Path(__file__).parents[2]
PACKAGES = "systemd,systemd-sysv,dbus,python3,python3-venv,openssl,ca-certificates"
NEEDED = ("debootstrap", "systemd-nspawn", "nsenter", "apt-get", "git")
_WHEELS, _SOURCES = "root/wheels", "root/sources"
_ENVIRONMENT = (
    "PATH=/usr/sbin:/usr/bin:/sbin:/bin", "HOME=/root", "LC_ALL=C.UTF-8",
    "PIP_NO_INDEX=1", f"PIP_FIND_LINKS=/{_WHEELS}",
)  # fmt: skip


class CannotBootError(Exception):
    """This machine makes or boots no container; the text says why."""


def make_debian(folder: Path) -> None:
    """Fill a folder with a Debian, our sources, and the packages that they need."""
    if os.geteuid() != 0:
        raise CannotBootError("only root may boot a container")
    missing = [program for program in NEEDED if shutil.which(program) is None]
    if missing:
        raise CannotBootError(f"not installed: {', '.join(missing)}")
    asked = ["apt-get", "indextargets", "--format", "$(SITE) $(RELEASE)", "Created-By: Packages"]
    releases = [line.split() for line in _said(asked).splitlines()]
    mirror, suite = next((site, name) for site, name in releases if "-" not in name)
    _said(["debootstrap", "--variant=minbase", f"--include={PACKAGES}", suite, str(folder), mirror])
    _lay_wheels(folder)
    lay_sources(folder)


def _lay_wheels(folder: Path) -> None:
    version = "import sys; print('%d.%d' % sys.version_info[:2])"
    python = _said(["chroot", str(folder), "python3", "-c", version]).strip()
    _said([
        sys.executable, "-m", "pip", "download", "--quiet", "--require-hashes",
        "--only-binary=:all:", f"--python-version={python}",
        "--dest", str(folder / _WHEELS), "-r", str(ROOT / "locks/requirements.lock"),
    ])  # fmt: skip


def lay_sources(folder: Path) -> None:
    """Unpack what git knows of this working tree."""
    target = folder / _SOURCES
    target.mkdir(parents=True, exist_ok=True)
    files = subprocess.run(
        ["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, check=True
    ).stdout
    pack = ["tar", "--create", "--null", "--files-from=-"]
    packed = subprocess.run(pack, cwd=ROOT, input=files, capture_output=True, check=True).stdout
    subprocess.run(["tar", "--extract", "--directory", target], input=packed, check=True)


def _said(command: list[str]) -> str:
    ended = subprocess.run(command, capture_output=True, text=True, timeout=900, check=False)
    if ended.returncode != 0:
        last = (ended.stderr or ended.stdout).strip().splitlines()[-1:]
        raise CannotBootError(f"{' '.join(command[:2])}: {' '.join(last)}")
    return ended.stdout


class Machine:
    """A machine without a network that can be booted and rebooted and that runs commands."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._container: subprocess.Popen[bytes] | None = None
        self._leader = 0

    def boot(self) -> None:
        log = self.folder.with_suffix(".log")
        with log.open("wb") as output:
            self._container = subprocess.Popen(
                [
                    "systemd-nspawn", f"--directory={self.folder}", "--boot", "--register=no",
                    "--keep-unit", "--private-network", "--link-journal=no", "--console=pipe",
                    f"--machine=clustermcl-{os.getpid()}",
                ],
                stdin=subprocess.DEVNULL, stdout=output, stderr=subprocess.STDOUT,
            )  # fmt: skip
        until_s = time.monotonic() + 60.0
        state = ""
        while state not in ("running", "degraded"):
            if self._container.poll() is not None or time.monotonic() > until_s:
                self.cut_power()
                raise CannotBootError(f"systemd {state or 'does not start'}: {log.read_text()}")
            time.sleep(0.2)
            children = psutil.Process(self._container.pid).children()
            if children:
                self._leader = children[0].pid
                state = self.run("systemctl is-system-running", check=False).strip()

    def reboot(self) -> None:
        assert self._container is not None
        self.run("systemctl poweroff", check=False)
        self._container.wait(60.0)
        self._leader = 0
        self.boot()

    def cut_power(self) -> None:
        """End it and all within at once."""
        if self._container is None:
            return
        with suppress(ProcessLookupError):  # systemd-nspawn ends with it, and cleans up
            os.kill(self._leader or self._container.pid, signal.SIGKILL)
        self._container.wait(30.0)
        self._container, self._leader = None, 0

    def run(self, script: str, *, check: bool = True, within_s: float = 900.0) -> str:
        """Run lines of bash as root inside; what they write to standard output."""
        enter = ["nsenter", f"--target={self._leader}", "--all"]
        shell = ["bash", "-euc", f"cd /{_SOURCES}\n{script}"]
        ended = subprocess.run(
            [*enter, "env", "--ignore-environment", *_ENVIRONMENT, *shell],
            capture_output=True, text=True, timeout=within_s, check=False,
        )  # fmt: skip
        if check and ended.returncode != 0:
            raise AssertionError(f"{shlex.quote(script)}: {ended.stdout}{ended.stderr}")
        return ended.stdout
