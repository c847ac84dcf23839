from typing import cast

import pytest
import zenoh

from clustermcl.link import metrics
from clustermcl.link.metrics import metrics_served
from clustermcl.protocol.errors import SettingsError
from clustermcl.runtime.settings import MetricsSettings

NO_SESSION = cast(zenoh.Session, None)


@pytest.fixture
def without_library(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(metrics, "find_spec", lambda _name: None)


@pytest.mark.usefixtures("without_library")
def test_a_port_without_the_library_is_refused_and_names_the_extra() -> None:
    with (
        pytest.raises(SettingsError, match=r"metrics\.port = 9464 .* 'clustermcl\[metrics\]'"),
        metrics_served(MetricsSettings(port=9464), "r1", lambda: NO_SESSION),
    ):
        pass


@pytest.mark.usefixtures("without_library")
def test_without_a_port_the_library_is_not_missed() -> None:
    with metrics_served(MetricsSettings(), "r1", lambda: NO_SESSION):
        pass
