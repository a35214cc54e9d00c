"""Random damage to valid files, as Hypothesis strategies."""

import copy
import dataclasses

import numpy as np
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

NUMBERS = st.sampled_from([0, -1, 1, 0.5, 1e5, 1e308, -1e308, -0.0, 2**31, 2**63, 10**30]) | st.floats() | st.integers()
OTHERS = st.sampled_from([None, True, "", "\x00", "../..", "9" * 5000, [], {}, [[]], {"a": {}}, "1e999", "a:b"])
FLOATS_32 = st.floats(width=32) | st.sampled_from([0.0, -1.0, 1e5])
IN_MESSAGES = {
    float: FLOATS_32,
    int: st.sampled_from([0, 1, 10**6, 2**31 - 1]),
    str: st.sampled_from(["", "/", "x" * 5000, "\x00", "odom", "base_link", "laser", "map"]),
}


@st.composite
def damaged_bytes(draw, content):
    """Cut, overwrite, insert, repeat, or flip bits, one to four times."""
    damaged = bytearray(content)
    for _ in range(draw(st.integers(1, 4))):
        at, length = draw(st.integers(0, len(damaged))), draw(st.integers(1, 200))
        match draw(st.integers(0, 4)):
            case 0:
                del damaged[at:]
            case 1:
                damaged[at : at + 16] = draw(st.binary(min_size=1, max_size=16))
            case 2:
                damaged[at:at] = draw(st.binary(min_size=1, max_size=16))
            case 3:
                damaged[at:at] = damaged[at : at + length]
            case 4 if at < len(damaged):
                damaged[at] ^= 1 << draw(st.integers(0, 7))
    return bytes(damaged)


def slots(tree):
    """Yield every mapping or list of a tree with each of its keys or indices."""
    for key in list(tree) if isinstance(tree, dict) else range(len(tree)):
        yield tree, key
        if isinstance(tree[key], dict | list):
            yield from slots(tree[key])


@st.composite
def damaged_tree(draw, tree):
    """Replace, scale, delete, rename, repeat or nest values of nested mappings and lists, one to three times."""
    tree = copy.deepcopy(tree)
    for _ in range(draw(st.integers(1, 3))):
        found = list(slots(tree))
        if not found:
            break
        holder, key = found[draw(st.integers(0, len(found) - 1))]
        value = holder[key]
        match draw(st.integers(0, 7)):
            case 0 | 1:
                holder[key] = draw(NUMBERS)
            case 2 | 3 if isinstance(value, int | float):
                holder[key] = value * 10.0 ** draw(st.integers(-9, 9))
            case 4:
                holder[key] = copy.deepcopy(draw(OTHERS))
            case 5:
                renamed = holder.pop(key)
                if isinstance(holder, dict) and draw(st.booleans()):
                    holder[f"{key}s"] = renamed
            case 6 if isinstance(value, list):
                holder[key] = value * draw(st.integers(2, 40))
            case 7:
                holder[key] = [[value]]
    return tree


@st.composite
def damaged_arrays(draw, content):
    """Replace one of several named arrays by an array of any type and shape, or replace one element."""
    key = draw(st.sampled_from(sorted(content)))
    array = np.array(content[key], dtype=float)
    if array.size and draw(st.booleans()):
        array.flat[draw(st.integers(0, array.size - 1))] = draw(st.floats())
    else:
        shape = draw(st.just(array.shape) | arrays.array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=6))
        array = draw(arrays.arrays(draw(arrays.scalar_dtypes() | arrays.unicode_string_dtypes(max_len=8)), shape))
    return content | {key: array}


@st.composite
def damaged_messages(draw, pairs):
    """Replace one to three values of (topic, message) pairs, and drop some pairs."""
    found = [slot for _, message in pairs for slot in _message_slots(message)]
    for _ in range(draw(st.integers(1, 3))):
        holder, name = found[draw(st.integers(0, len(found) - 1))]
        value = getattr(holder, name)
        if isinstance(value, np.ndarray):
            value = value.copy()
            if len(value):
                value[draw(st.integers(0, len(value) - 1))] = draw(FLOATS_32)
            if value.dtype == np.float32:
                value = value[: draw(st.integers(0, len(value)))]
        else:
            value = draw(IN_MESSAGES[type(value)])
        object.__setattr__(holder, name, value)
    return pairs[: draw(st.integers(0, len(pairs)))] if draw(st.booleans()) else pairs


def _message_slots(message):
    """Yield every part of a message that holds values, with their names."""
    for field in dataclasses.fields(message):
        value = getattr(message, field.name)
        if isinstance(value, float | int | str | np.ndarray) and field.name != "__msgtype__":
            yield message, field.name
        for one in value if isinstance(value, list) else [value]:
            if dataclasses.is_dataclass(one):
                yield from _message_slots(one)
