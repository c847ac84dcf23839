"""Starts the command `clustermcl`."""

import signal

from clustermcl.runtime.parent import open_standard_files


def main() -> None:
    """Run the command, so that Ctrl-C during the slow imports ends the process silently.

    With Python's own handler, an interrupt during an import would print a traceback or be ignored.
    """
    open_standard_files()
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:  # nohup ignores SIGINT
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    from clustermcl.commands.command import main as command  # noqa: PLC0415 - see above

    command()


if __name__ == "__main__":
    main()
