"""Rejects YAML aliases, with which a few lines can expand beyond any memory."""

from pathlib import Path

import yaml

from clustermcl.protocol.errors import InputFileError


def refuse_aliases(content: bytes, path: Path, error: type[InputFileError]) -> None:
    """Reject aliases: no map needs one, and ROS parameter files cannot have them.

    Raises:
        InputFileError: of the type `error`; names the line.
        yaml.YAMLError: the text is not YAML.
    """
    for event in yaml.parse(content, yaml.SafeLoader):
        if isinstance(event, yaml.AliasEvent):
            line = event.start_mark.line + 1 if event.start_mark else None
            raise error(path, "YAML aliases (*) are not read: write the value out", line=line)
