import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocol import keys
from protocol.errors import MalformedMessageError
from protocol.names import is_name


@given(
    st.from_regex(r"[a-zA-Z0-9_]+(-[a-zA-Z0-9_]+)*", fullmatch=True).filter(lambda n: len(n) < 65)
)
def test_a_workers_name_is_read_out_of_its_keys(name: str) -> None:
    assert is_name(name)
    assert keys.worker_name(keys.worker_report(name)) == name


@pytest.mark.parametrize(
    "name",
    ["", "a b", "a\n", "\x1b[2J", "a.b", "a*", "$*", "@a", "-a", "a-", "a--b", "ä", "x" * 65],
)
def test_an_invalid_name_in_a_key_is_malformed_and_counted_under_a_fixed_cause(name: str) -> None:
    assert not is_name(name)
    with pytest.raises(MalformedMessageError) as caught:
        keys.worker_name(keys.worker_alive(name))
    assert caught.value.cause == "malformed worker name: impossible"
    assert str(caught.value).isprintable()
