"""Public methods that subclasses and objects of users replace, and that kernels therefore must not replace."""

import inspect
from functools import cache
from typing import Any


@cache
def public_methods(kind: type) -> frozenset[str]:
    """Return the names of the public methods and properties of a class, including inherited ones."""
    members = {name: inspect.getattr_static(kind, name) for name in dir(kind) if name[0] != "_"}
    return frozenset(name for name, one in members.items() if inspect.isroutine(one) or isinstance(one, property))


def shadowed(thing: Any) -> list[str]:
    """Return the public methods of an object that its own attributes hide."""
    return sorted(public_methods(type(thing)).intersection(getattr(thing, "__dict__", ())))


def overridden(thing: Any) -> list[str]:
    """Return the public methods of the package's class of an object that a subclass, mixin or attribute replaces."""
    kinds = type(thing).__mro__
    first = next(i for i, kind in enumerate(kinds) if kind.__module__.startswith("lidarnaut.") or kind is object)
    names = {name for kind in kinds[:first] for name in vars(kind)}
    return sorted({*public_methods(kinds[first]).intersection(names), *shadowed(thing)})
