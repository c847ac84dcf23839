from tests.unit.programs import ran

FIRST_DECODED_BY_FOUR_THREADS = """
import faulthandler, sys, threading
import msgspec
from protocol.codec import decode
from protocol.message import Message

faulthandler.enable()
sys.setswitchinterval(1e-6)
for number in range(60):
    inner = [
        msgspec.defstruct(f"Inner{number}_{k}", [(f"f{j}", int) for j in range(30)])
        for k in range(20)
    ]
    kind = msgspec.defstruct(
        f"Outer{number}", [(f"g{k}", each) for k, each in enumerate(inner)],
        bases=(Message,), tag=f"outer{number}/1", kw_only=True, frozen=True,
    )
    fields = {f"g{k}": {f"f{j}": 1 for j in range(30)} for k in range(20)}
    data = msgspec.msgpack.encode({"schema": f"outer{number}/1", "sender": "a", **fields})
    start, decoded = threading.Barrier(4), []
    def run():
        start.wait()
        decoded.append(decode(data, kind))
    threads = [threading.Thread(target=run) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(decoded) == 4
"""


def test_several_threads_can_decode_a_new_class_at_the_same_time() -> None:
    ended = ran(FIRST_DECODED_BY_FOUR_THREADS, check=False, timeout_s=100.0)
    assert ended.returncode == 0, ended.stderr[-2000:]
