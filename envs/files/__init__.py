"""Reading YAML files into checked records, names into objects, and writing files that are whole or absent."""

from .names import explain_unknown, load_object, resolve
from .records import dump_record, explain_errors, parse_record, read_mapping, read_record
from .writing import temporary_beside, write_file, write_folder

__all__ = [
    "dump_record",
    "explain_errors",
    "explain_unknown",
    "load_object",
    "parse_record",
    "read_mapping",
    "read_record",
    "resolve",
    "temporary_beside",
    "write_file",
    "write_folder",
]
