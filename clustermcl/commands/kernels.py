"""Compiles the kernels for a command, which says that it takes a while."""

from clustermcl.commands.verbosity import say
from clustermcl.filter.kernels import library as kernel_library
from clustermcl.filter.settings import SensorSettings
from clustermcl.jobs.warm_up import compile_kernels


def prepare_kernels(sensor: SensorSettings) -> None:
    """Build the library of kernels if it is not on disk; errors as `compile_kernels`."""
    if kernel_library.library() is None:
        say("compiling the kernels, some 20 s")
    compile_kernels(sensor)
