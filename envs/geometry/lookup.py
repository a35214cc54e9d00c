"""Fast scalar array reads, and types of record arrays, for Numba functions.

Scalar reads avoid gather instructions, which are slow on Intel processors with the Downfall mitigation.
"""

import operator
from typing import Any

import numpy as np
from numba import config, types
from numba.core import cgutils
from numba.extending import intrinsic
from numba.np.unsafe import ndarray


@intrinsic
def _load(typing_context: Any, array: Any, index: Any) -> Any:
    if not (isinstance(array, types.Array) and array.ndim == 1 and array.layout == "C"):
        return None
    if index not in (types.uint32, types.uint64):
        return None

    def generate(context, builder, signature, args):
        view = context.make_array(signature.args[0])(context, builder, args[0])
        position = builder.zext(args[1], cgutils.intp_t) if index == types.uint32 else args[1]
        return builder.load_atomic(builder.gep(view.data, [position]), "unordered", array.dtype.bitwidth // 8)

    return array.dtype(array, index), generate


load: Any = _load
"""Function `load(array, index)` that reads an array element quickly in Numba code, without bounds check."""
as_tuple: Any = ndarray.to_fixed_tuple
"""`as_tuple(array, size)` returns the first `size` elements as a tuple. `size` is a compile-time constant."""
if config.DISABLE_JIT:  # type: ignore[attr-defined]
    load, as_tuple = operator.getitem, lambda array, size: tuple(array[:size])
    np.seterr(all="ignore")  # NaN, infinity and overflow are expected in kernels


def record_type(fields: Any) -> np.dtype:
    """Return a structured dtype with fields that are read as attributes (`record.name`), also if Numba is disabled."""
    return np.dtype((np.record, fields) if config.DISABLE_JIT else fields)  # type: ignore[attr-defined]
