"""The first moments of the command, before anything that takes long to import."""

import signal


def main() -> None:
    """Run the command.

    Until it listens to signals itself, Ctrl-C ends it at once and silently: an interrupt that is
    raised amid an import ends in a traceback, or is swallowed there and has no effect at all.
    """
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:  # not ignored, by nohup
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    from clustermcl.command import main as command  # noqa: PLC0415 - see above

    command()


if __name__ == "__main__":
    main()
