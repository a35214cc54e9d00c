"""Reading scattered elements of an array one by one.

Compilers turn a loop over `array[index[k]]` into gather instructions. On processors whose microcode guards those
against Downfall (most Intel servers up to Ice Lake) a gather takes several times as long as the loads it replaces.
"""

from typing import Any

from numba import types
from numba.core import cgutils
from numba.extending import intrinsic


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
