"""Public methods that users replace by their own, which kernels must not skip."""

import inspect
from functools import cache
from typing import Any


@cache
def public_methods(kind: Any) -> frozenset[str]:
    """Return the names of the public methods and properties of a class, also of inherited ones."""
    members = {name: inspect.getattr_static(kind, name) for name in dir(kind) if name[0] != "_"}
    return frozenset(name for name, one in members.items() if inspect.isroutine(one) or isinstance(one, property))


def shadowed(thing: Any) -> list[str]:
    """Return the public methods of an object that its own attributes replace."""
    kind: Any = type(thing)
    return sorted(public_methods(kind).intersection(getattr(thing, "__dict__", ())))


def overridden(thing: Any) -> list[str]:
    """Return the public methods of an object's class in the package that a subclass, mixin or attribute replaces."""
    kinds = type(thing).__mro__
    first = next(i for i, kind in enumerate(kinds) if kind.__module__.startswith("lidarnaut.") or kind is object)
    names = {name for kind in kinds[:first] for name in vars(kind)}
    return sorted(public_methods(kinds[first]) & names) or shadowed(thing)
