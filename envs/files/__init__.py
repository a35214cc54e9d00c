"""YAML and JSON records, NumPy archives, lookup by name, locks and atomic writing."""

from .archives import MAX_BYTES, check_file, open_archive, read_bytes
from .locking import Lock, LockedError
from .names import SHORT, explain_unknown, load_object, printable, resolve, split_parameters, with_defaults
from .writing import append_file, naming, own_folder, remove_leftovers, temporary_beside, write_file, write_folder
from .yaml_models import MAX_JSON_BYTES, dump_record, explain_errors, parse_record, read_json, read_mapping, read_record

__all__ = [
    "MAX_BYTES",
    "MAX_JSON_BYTES",
    "SHORT",
    "Lock",
    "LockedError",
    "append_file",
    "check_file",
    "dump_record",
    "explain_errors",
    "explain_unknown",
    "load_object",
    "naming",
    "open_archive",
    "own_folder",
    "parse_record",
    "printable",
    "read_bytes",
    "read_json",
    "read_mapping",
    "read_record",
    "remove_leftovers",
    "resolve",
    "split_parameters",
    "temporary_beside",
    "with_defaults",
    "write_file",
    "write_folder",
]
