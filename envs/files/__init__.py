"""YAML files into checked records, and names into objects: what every folder reads its inputs with."""

from .names import explain_unknown, load_object, resolve
from .records import dump_record, explain_errors, parse_record, read_mapping, read_record

__all__ = [
    "dump_record",
    "explain_errors",
    "explain_unknown",
    "load_object",
    "parse_record",
    "read_mapping",
    "read_record",
    "resolve",
]
