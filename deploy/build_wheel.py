"""Ships the compiled kernels in the wheel, so that a robot needs neither numba nor a compiler."""

import platform
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface


class CompiledKernels(BuildHookInterface[Any]):
    """A hook of hatchling: the library of kernels for each kind of processor of this machine."""

    PLUGIN_NAME = "custom"

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Compile the libraries, unless the wheel only points to this tree.

        Raises:
            subprocess.CalledProcessError: there is no numba or no C compiler.
        """
        sys.path.insert(0, self.root)
        from clustermcl.filter.kernels.library import SHIPPED, shipped_file  # noqa: PLC0415

        processors = SHIPPED.get(platform.machine(), {})
        if version == "editable" or not processors:
            return
        self.folder = TemporaryDirectory()
        building = []
        for processor in processors:
            target = shipped_file(processor)
            file = Path(self.folder.name, target.name)
            build_data["force_include"][str(file)] = str(target.relative_to(self.root))
            command = [sys.executable, "-m", "clustermcl.jobs.build_kernels", str(file), processor]
            building.append(subprocess.Popen(command, cwd=self.root))
        for process in building:
            if process.wait():
                raise subprocess.CalledProcessError(process.returncode, process.args)
        build_data["infer_tag"], build_data["pure_python"] = True, False

    def finalize(self, version: str, build_data: dict[str, Any], artifact_path: str) -> None:  # noqa: ARG002
        """Remove what the wheel has now."""
        if version != "editable" and hasattr(self, "folder"):
            self.folder.cleanup()
