"""Work for processes that tests start."""

import os
import time

from clustermcl.protocol.errors import MapFileError


def work(piece: str) -> str:
    match piece:
        case "refuse":
            raise MapFileError("map.yaml", "a bad line", line=7)
        case "die":
            os._exit(7)
        case "hang":
            time.sleep(600.0)  # ended from outside
    return piece.upper()
