"""numpy's own tangent, inverse functions and power, called from kernels.

They are accurate to the last bit but one, and so are those of the C library that numba calls; on processors with
AVX-512 numpy uses other code, and the two differ in up to one of twelve results. That would matter nowhere if
highway-env were stable. Below 0.7 m/s its steering is not: a rounding error grows sevenfold in every sub-step, and a
car that stops after a bend ends up centimetres away. So the replica has to round as highway-env does.

The address of a loop is read from the ufunc (struct ``PyUFuncObject`` of numpy's C interface) and given a name for
LLVM's linker, because it is another one in every process and compiled code is kept between processes.

With ``NUMBA_DISABLE_JIT=1`` nothing is compiled. Kernels run as Python, so that a debugger stops in them, and call
numpy's functions in the usual way.
"""

import ctypes
from typing import Any

import numpy as np
from llvmlite import binding, ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from sumo_env.replica.compiled import AS_PYTHON, inlined

BYTE, NUMBER = ir.IntType(8), ir.IntType(64)
POINTER = BYTE.as_pointer()


class _UFunc(ctypes.Structure):
    _fields_ = [
        ("head", ctypes.c_byte * object.__basicsize__),
        *((name, ctypes.c_int) for name in ("inputs", "outputs", "arguments", "identity")),
        ("functions", ctypes.POINTER(ctypes.c_void_p)),
        ("data", ctypes.POINTER(ctypes.c_void_p)),
    ]


def _named(ufunc: Any) -> Any:
    """The loop of a ufunc for float64, as an external function of kernels; its data has a name as well."""
    fields, k = _UFunc.from_address(id(ufunc)), ufunc.types.index("d" * ufunc.nin + "->d")
    name, loop = f"sumo_env_{ufunc.__name__}", fields.functions[k]
    binding.add_symbol(name, loop)
    binding.add_symbol(f"{name}_data", (fields.data[k] if fields.data else None) or loop)
    return types.ExternalFunction(name, types.void())


UFUNCS = (np.tan, np.arcsin, np.arctan, np.arctan2, np.power)
tan, arcsin, arctan, arctan2, power = UFUNCS if AS_PYTHON else map(_named, UFUNCS)


def _call(builder: Any, name: str, pointers: list[Any], count: Any) -> None:
    """Emit ``loop(pointers, &count, strides, data)`` for `count` elements of arrays that begin at the pointers."""
    arrays = cgutils.alloca_once(builder, ir.ArrayType(POINTER, len(pointers)))
    strides = cgutils.alloca_once(builder, ir.ArrayType(NUMBER, len(pointers)))
    for k, pointer in enumerate(pointers):
        builder.store(pointer, cgutils.gep_inbounds(builder, arrays, 0, k))
        builder.store(NUMBER(8), cgutils.gep_inbounds(builder, strides, 0, k))
    module, data = builder.module, f"{name}_data"
    arguments = [
        builder.bitcast(arrays, POINTER.as_pointer()),
        cgutils.alloca_once_value(builder, count),
        builder.bitcast(strides, NUMBER.as_pointer()),
        module.globals.get(data) or cgutils.add_global_variable(module, BYTE, data),
    ]
    function = ir.FunctionType(ir.VoidType(), [argument.type for argument in arguments])
    builder.call(cgutils.get_or_insert_function(module, function, name), arguments)


def _emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    """One element: the inputs and the result in cells of their own."""
    cells = [cgutils.alloca_once(builder, ir.DoubleType()) for _ in arguments]
    for cell, value in zip(cells, arguments[1:], strict=False):
        builder.store(value, cell)
    _call(builder, signature.args[0].symbol, [builder.bitcast(cell, POINTER) for cell in cells], NUMBER(1))
    return builder.load(cells[-1])


def _emit_each(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    """Arrays; the results replace the first."""
    parts = zip(signature.args[1:], arguments[1:], strict=True)
    arrays = [context.make_array(kind)(context, builder, array) for kind, array in parts]
    pointers = [builder.bitcast(array.data, POINTER) for array in (*arrays, arrays[0])]
    _call(builder, signature.args[0].symbol, pointers, arrays[0].nitems)
    return context.get_dummy_value()


def _unary(typing_context: Any, loop: Any, x: Any) -> Any:
    return types.float64(loop, types.float64), _emit


def _binary(typing_context: Any, loop: Any, x: Any, y: Any) -> Any:
    return types.float64(loop, types.float64, types.float64), _emit


def _each(typing_context: Any, loop: Any, numbers: Any) -> Any:
    return types.void(loop, numbers), _emit_each


def _each_pair(typing_context: Any, loop: Any, numbers: Any, others: Any) -> Any:
    return types.void(loop, numbers, others), _emit_each


def _of(loop: Any, *numbers: float) -> float:
    return float(loop(*numbers))


def _in_place(loop: Any, numbers: Any, *others: Any) -> None:
    loop(numbers, *others, out=numbers)


_of_one: Any = _of if AS_PYTHON else intrinsic(_unary)
# the arc tangent of y and x or the power of two numbers, such as ``binary(power, x, y)``
binary: Any = _of if AS_PYTHON else intrinsic(_binary)
# the function of every number of an array, in place; some loops take eight for the time of one
each: Any = _in_place if AS_PYTHON else intrinsic(_each)
# the function of two numbers for every number of an array and of another; the results replace the former
each_pair: Any = _in_place if AS_PYTHON else intrinsic(_each_pair)


@inlined
def unary(loop: Any, x: float) -> float:
    """The tangent, arc sine or arc tangent of a number, such as ``unary(tan, x)``; all of 0 are 0."""
    return x if x == 0.0 else _of_one(loop, x)
