"""YAML and JSON records, NumPy archives, lookup by name, locks and atomic writing."""

from .archives import MAX_BYTES, check_file, open_archive, read_bytes
from .locking import Lock, LockedError
from .names import SHORT, explain_unknown, load_object, printable, resolve, split_parameters, with_defaults
from .writing import append_file, naming, own_folder, temporary_beside, write_file, write_folder
from .yaml_models import MAX_JSON_BYTES, dump_record, explain_errors, parse_record, read_json, read_mapping, read_record
