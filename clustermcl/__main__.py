"""Starts the command, before slow imports."""

import signal


def main() -> None:
    """Run the command.

    Until the command handles signals itself, Ctrl-C ends the process silently. An interrupt that
    is raised during an import would print a traceback, or be ignored.
    """
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:  # not ignored, by nohup
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    from clustermcl.command import main as command  # noqa: PLC0415 - see above

    command()


if __name__ == "__main__":
    main()
