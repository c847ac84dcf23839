"""What happens to a worker, as values: a test is a list of them."""

from collections.abc import Callable
from functools import partial
from operator import methodcaller
from typing import TypeAlias

from clustermcl.worker.worker import Instruction, Worker

Event: TypeAlias = Callable[[Worker], list[Instruction]]

on_scan = partial(methodcaller, "on_scan")
on_checkpoint = partial(methodcaller, "on_checkpoint")
on_order = partial(methodcaller, "on_order")
refuse = partial(methodcaller, "refuse")
on_state_query = partial(methodcaller, "on_state_query")
on_map = partial(methodcaller, "on_map")
on_map_failure = partial(methodcaller, "on_map_failure")
on_model = partial(methodcaller, "on_model")
on_history = partial(methodcaller, "on_history")
on_no_history = partial(methodcaller, "on_no_history")
search = partial(methodcaller, "search")
