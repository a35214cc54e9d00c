"""Reading scattered elements of an array one by one.

Compilers turn a loop over `array[index[k]]` into gather instructions. On processors whose microcode guards those
against Downfall (most Intel servers up to Ice Lake) a gather takes about four times as long as the loads it stands
for, and on others it gains little: `python -m benchmarks.throughput` has both cases.
"""

from numba import types
from numba.core import cgutils
from numba.extending import intrinsic


@intrinsic
def load(typing_context, array, index):
    """Return `array[index]`, without bounds check, by a load of its own.

    Args:
        typing_context: passed by the compiler.
        array: shape (n,), C-contiguous.
        index: uint32 or uint64, below n.
    """
    if not (isinstance(array, types.Array) and array.ndim == 1 and array.layout == "C"):
        return None
    if not (isinstance(index, types.Integer) and not index.signed):
        return None

    def generate(context, builder, signature, args):
        view = context.make_array(signature.args[0])(context, builder, args[0])
        position = builder.zext(args[1], cgutils.intp_t) if index.bitwidth < 64 else args[1]
        # Unordered atomic loads are plain loads to the processor, and may not be merged by the compiler.
        return builder.load_atomic(builder.gep(view.data, [position]), "unordered", array.dtype.bitwidth // 8)

    return array.dtype(array, index), generate
