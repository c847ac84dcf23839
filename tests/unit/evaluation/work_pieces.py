"""Work for processes that tests start."""

import os
import signal
import time

from clustermcl.protocol.errors import SettingsError


def work(piece: str) -> str:
    match piece:
        case "refuse":
            raise SettingsError(key="x", problem="a bad setting")
        case "die":
            os._exit(7)
        case "signalled":
            os.kill(os.getpid(), signal.SIGTERM)
            os.kill(os.getpid(), signal.SIGINT)
        case "hang":
            time.sleep(600.0)  # ended from outside
    return piece.upper()
