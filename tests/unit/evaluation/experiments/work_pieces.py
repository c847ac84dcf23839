"""Work for processes that tests start."""

import os
import signal
import time
from collections.abc import Callable

from protocol.errors import SettingsError


def work(piece: str, advanced: Callable[[int], None]) -> str:
    match piece:
        case "fail":
            raise ZeroDivisionError("nothing to divide by")
        case "refuse":
            raise SettingsError(key="x", problem="two\nlines")
        case "die":
            os._exit(7)
        case "signalled":
            os.kill(os.getpid(), signal.SIGTERM)
            os.kill(os.getpid(), signal.SIGINT)
        case "hang":
            advanced(1)
            time.sleep(600.0)  # ended from outside
    advanced(2)
    return piece.upper()
