"""Reading YAML files into checked records, archives, names into objects, and writing files that are whole or absent."""

from .archives import MAX_BYTES, open_archive
from .locking import Lock, LockedError
from .names import SHORT, explain_unknown, load_object, resolve
from .records import dump_record, explain_errors, parse_record, read_mapping, read_record
from .writing import naming, sweep, temporary_beside, write_file, write_folder

__all__ = [
    "MAX_BYTES",
    "SHORT",
    "Lock",
    "LockedError",
    "dump_record",
    "explain_errors",
    "explain_unknown",
    "load_object",
    "naming",
    "open_archive",
    "parse_record",
    "read_mapping",
    "read_record",
    "resolve",
    "sweep",
    "temporary_beside",
    "write_file",
    "write_folder",
]
