"""What a log says of a robot: logs of files."""

from flexhinf.identification.log import Log, read_log

__all__ = ["Log", "read_log"]
