"""Reading elements of arrays in kernels, by compiled code or, under `NUMBA_DISABLE_JIT=1`, by Python's own.

`load` reads scattered elements one by one. Compilers turn a loop over `array[index[k]]` into gather instructions. On
processors whose microcode guards those against Downfall (most Intel servers up to Ice Lake) a gather takes several
times as long as the loads it replaces.
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
    """Return `array[index]`, without bounds check, by a load of its own.

    `array`: shape (n,), C-contiguous; `index`: uint32 or uint64, below n.
    """
    if not (isinstance(array, types.Array) and array.ndim == 1 and array.layout == "C"):
        return None
    if index not in (types.uint32, types.uint64):
        return None

    def generate(context, builder, signature, args):
        view = context.make_array(signature.args[0])(context, builder, args[0])
        position = builder.zext(args[1], cgutils.intp_t) if index == types.uint32 else args[1]
        # Unordered atomic loads are plain loads to the processor, and may not be merged by the compiler.
        return builder.load_atomic(builder.gep(view.data, [position]), "unordered", array.dtype.bitwidth // 8)

    return array.dtype(array, index), generate


load: Any = _load
"""`load(array, index)`; see `_load`."""
as_tuple: Any = ndarray.to_fixed_tuple
"""`as_tuple(array, size)`: the first elements of an array, shape (n,), as a tuple; `size` is a constant."""
if config.DISABLE_JIT:  # type: ignore[attr-defined]
    load, as_tuple = operator.getitem, lambda array, size: tuple(array[:size])
    np.seterr(all="ignore")  # as in compiled kernels, where NaN, infinity and overflowing hashes are regular


def record_type(fields: Any) -> np.dtype:
    """Return a structured dtype whose fields kernels read as attributes, compiled or not."""
    return np.dtype((np.record, fields) if config.DISABLE_JIT else fields)  # type: ignore[attr-defined]
