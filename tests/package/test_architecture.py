import ast
import functools
import graphlib
import itertools
import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
PACKAGES = ("lidarnaut", "envs", "baselines", "agents", "driver", "benchmarks")


def floors():
    """Return the rows of the table from the top down, each a list of files and folders."""
    lines = (ROOT / "docs" / "concepts" / "architecture.md").read_text(encoding="utf-8").splitlines()
    first = next(k for k, line in enumerate(lines) if line.startswith("| rows from the top down"))
    rows = itertools.takewhile(lambda line: line.startswith("|"), lines[first + 2 :])
    return [re.findall(r"`([^`]+)`", row.split("|")[1]) for row in rows]


def modules():
    """Return the paths of all modules outside of tests by name."""
    paths = [path for package in PACKAGES for path in (ROOT / package).rglob("*.py")]
    paths += [ROOT / "train.py", ROOT / "evaluate.py"]
    relative = {path.relative_to(ROOT) for path in paths if not path.is_symlink()}
    parts = {path: ["lidarnaut", *path.with_suffix("").parts] for path in sorted(relative)}
    return {".".join(names[names[1] == "lidarnaut" :]).removesuffix(".__init__"): path for path, names in parts.items()}


@functools.cache
def tree(path):
    return ast.parse((ROOT / path).read_text(encoding="utf-8"))


def floor_of(path, rows):
    """Return the row index of a file: the row that names the file, or its folder."""
    names = (path.as_posix(), *(parent.as_posix() for parent in path.parents))
    return next((k for name in names for k, row in enumerate(rows) if name in row), None)


def imports(path, name, known):
    package = name if path.name == "__init__.py" else name.rpartition(".")[0]
    found = set()
    for node in ast.walk(tree(path)):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = package.split(".")[: len(package.split(".")) - node.level + 1] if node.level else []
            base = ".".join([*base, *([node.module] if node.module else [])])
            found |= {f"{base}.{alias.name}" if f"{base}.{alias.name}" in known else base for alias in node.names}
    return {module for module in found if module in known}


def edges():
    known = modules()
    return [(path, known[other]) for name, path in known.items() for other in imports(path, name, known)]


def test_every_module_lives_on_a_floor():
    rows = floors()
    assert len(rows) > 15
    assert [str(path) for path in modules().values() if floor_of(path, rows) is None] == []
    assert [name for row in rows for name in row if not (ROOT / name).exists()] == []


def test_modules_import_from_their_own_floor_and_below_only():
    rows = floors()
    upward = [f"{path} imports {other}" for path, other in edges() if floor_of(other, rows) < floor_of(path, rows)]
    assert upward == []


def test_no_folders_import_each_other_in_circles():
    below = {}
    for path, other in edges():
        folder, other_folder = (Path(*each.parts[:2]) for each in (path, other))
        if folder != other_folder and path.parts[0] == other.parts[0] == "envs":
            below.setdefault(folder, set()).add(other_folder)
    graphlib.TopologicalSorter(below).prepare()


READERS = {
    "read_text", "read_bytes", "loadtxt", "genfromtxt", "fromfile", "load_file", "load_npz", "unsafe_load",
    "np.load", "json.load", "pickle.load", "pickle.loads", "torch.load", "yaml.load",
}  # fmt: skip
READ_ANYTHING = {
    "envs/files/archives.py", "envs/files/yaml_models.py", "envs/player/page.py",
    "benchmarks/demo.py",
    "benchmarks/drives/localization.py", "benchmarks/speed/peers/step.py",
    "envs/vector/workers.py",
    "envs/compilation.py",
}  # fmt: skip
"""Allowed: readers with limits; readers of the package's templates, of files and messages of the same command, and of
code in the user's folders."""


def test_files_of_others_are_read_by_the_readers_with_limits():
    found = set()
    for path in modules().values():
        for node in ast.walk(tree(path)):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
                owner, name = ast.unparse(node.func.value), node.func.attr
                is_in_memory = node.args and ast.unparse(node.args[0]).startswith("io.BytesIO(")
                if {name, f"{owner}.{name}"} & READERS and not is_in_memory:
                    found.add(path.as_posix())
    assert found - READ_ANYTHING == set()


MAX_ATTRIBUTES, MAX_ENV_LINES = 25, 330
"""Upper limits of the attributes that methods of a class assign, and of the lines of `LidarEnv`."""


def attributes(kind):
    """Return the names of the attributes that methods of a class assign to `self`."""
    nodes = [node for method in kind.body if isinstance(method, ast.FunctionDef) for node in ast.walk(method)]
    stored = [node for node in nodes if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store)]
    return {node.attr for node in stored if isinstance(node.value, ast.Name) and node.value.id == "self"}


def test_no_class_has_many_attributes_and_the_environment_stays_short():
    kinds = [node for path in modules().values() for node in tree(path).body if isinstance(node, ast.ClassDef)]
    assert {kind.name for kind in kinds if len(attributes(kind)) > MAX_ATTRIBUTES} == set()
    (env,) = (kind for kind in kinds if kind.name == "LidarEnv")
    assert env.end_lineno - env.lineno + 1 <= MAX_ENV_LINES
