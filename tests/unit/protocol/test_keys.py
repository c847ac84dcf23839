import pytest
from hypothesis import given
from hypothesis import strategies as st

from clustermcl.protocol import keys
from clustermcl.protocol.errors import MalformedMessageError
from clustermcl.protocol.keys import is_name


@given(
    st.from_regex(r"[a-zA-Z0-9_]+(-[a-zA-Z0-9_]+)*", fullmatch=True).filter(lambda n: len(n) < 65)
)
def test_a_workers_name_is_read_out_of_its_keys(name: str) -> None:
    assert is_name(name)
    made = (
        *(keys.worker_alive(name), keys.worker_order(name), keys.worker_state(name)),
        *(keys.worker_advice(name), keys.worker_report(name), keys.worker_health(name)),
    )
    assert len(set(made)) == len(made)
    assert {keys.worker_name(key) for key in made} == {name}


@pytest.mark.parametrize("name", ["", "a\n", "a.b", "$*", "@a", "-a", "a--b", "ä", "x" * 65])
def test_an_invalid_name_in_a_key_is_malformed_and_counted_under_a_fixed_cause(name: str) -> None:
    assert not is_name(name)
    with pytest.raises(MalformedMessageError) as caught:
        keys.worker_name(keys.worker_alive(name))
    assert caught.value.cause == "malformed worker name: impossible"
    assert str(caught.value).isprintable()


@pytest.mark.parametrize("key", ["", "worker/w-0", "worker/a/b/report", "other/w-0/report"])
def test_only_a_workers_key_has_a_workers_name(key: str) -> None:
    with pytest.raises(MalformedMessageError, match="worker's key"):
        keys.worker_name(key)
