"""How many keys the router knows: they must not grow with every process that starts anew."""

import zenoh

from process_runtime.settings import Settings
from soak_test.verdict import Verdict
from zenoh_link.configuration import as_zenoh, client_configuration

_COUNTED = ("/subscriber/", "/queryable/", "/token/", "/publisher/")


def open_plain(settings: Settings) -> zenoh.Session:
    """A session that sees the router's own keys, which no robot's name stands before.

    Raises:
        zenoh.ZError: there is no router.
    """
    configuration = client_configuration(settings.zenoh, settings.robot)
    del configuration["namespace"]
    return zenoh.open(as_zenoh(configuration))


class RouterKeys:
    """Counts now and then."""

    def __init__(self) -> None:
        self._counts: list[int] = []

    def count(self, session: zenoh.Session, timeout_s: float = 1.0) -> None:
        """Ask the router; one that does not answer is not counted."""
        found = [
            str(reply.ok.key_expr)
            for reply in session.get("@/*/router/**", timeout=timeout_s)
            if reply.ok is not None
        ]
        counted = sum(any(word in key for word in _COUNTED) for key in found)
        if counted:
            self._counts.append(counted)

    def verdict(self) -> Verdict:
        """Whether there are no more in the end than in the beginning."""
        promise, target = "the router's keys do not grow", "as many as at first"
        if len(self._counts) < 2:
            return Verdict(promise=promise, target=target, measured="not counted", kept=None)
        first, last, most = self._counts[0], self._counts[-1], max(self._counts)
        return Verdict(
            promise=promise,
            target=target,
            measured=f"{first} at first, {last} in the end, {most} at most",
            kept=last <= first,
            figures={"first": first, "last": last, "most": most},
        )
