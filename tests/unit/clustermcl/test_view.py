"""What `clustermcl view` and `demo --view` refuse before anything is started."""

import pytest

from clustermcl import view
from clustermcl.demo import DemoOptions, run_demo
from live_view.admission import Address
from process_runtime.settings import Settings
from protocol.errors import SettingsError


def test_without_the_extra_a_person_is_told_what_to_install(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(view, "find_spec", lambda _name: None)
    with pytest.raises(view.PageNotInstalledError, match=r"clustermcl\[view\]"):
        view.page_address("127.0.0.1:1")


def test_with_it_the_address_is_read() -> None:
    assert view.page_address("127.0.0.1:81") == Address("127.0.0.1", 81)


@pytest.mark.parametrize("listen", ["0.0.0.0:8350", "127.0.0.1:0"])
def test_a_demo_is_shown_on_this_machine_at_a_port_that_is_named(listen: str) -> None:
    with pytest.raises(SettingsError, match="this machine alone"):
        run_demo(DemoOptions(view_at=listen), Settings())
