from typing import cast

import pytest
import zenoh

from clustermcl.link import metrics
from clustermcl.link.metrics import metrics_served
from clustermcl.protocol.errors import SettingsError
from clustermcl.runtime.settings import MetricsSettings

NO_SESSION = cast(zenoh.Session, None)


def test_the_library_is_needed_with_a_port_only_and_its_extra_is_named(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(metrics, "find_spec", lambda _name: None)
    with metrics_served(MetricsSettings(), "r1", lambda: NO_SESSION):
        pass
    with (
        pytest.raises(SettingsError, match=r"metrics\.port = 9464 .* 'clustermcl\[metrics\]'"),
        metrics_served(MetricsSettings(port=9464), "r1", lambda: NO_SESSION),
    ):
        pass
